//! Where nothing lies above or below a region. `layer_plan` uses it.

use super::offset::{Area, Point};
use super::region::Region;

/// Cells of the index along each axis. A layer of 50,000 regions has 50 in a cell.
const CELLS: i32 = 32;

/// The regions of a neighbouring layer, found by place.
pub(super) struct Cover {
    areas: Vec<(Area, [Point; 2])>,
    low: Point,
    /// Size of a cell, nanometres, at least 1.
    cell_nm: [i32; 2],
    /// Numbers of the areas whose bounds touch each cell.
    cells: Vec<Vec<u32>>,
}

impl Cover {
    /// Indexes the regions of a layer.
    pub(super) fn new(regions: &[Region]) -> Self {
        let areas: Vec<(Area, [Point; 2])> =
            regions.iter().map(Area::of).filter_map(|area| area.bounds_nm().map(|bounds| (area, bounds))).collect();
        let low = areas.iter().map(|(_, [low, _])| *low).reduce(|a, b| Point::new(a.x.min(b.x), a.y.min(b.y)));
        let high = areas.iter().map(|(_, [_, high])| *high).reduce(|a, b| Point::new(a.x.max(b.x), a.y.max(b.y)));
        let (low, high) = (low.unwrap_or(Point::new(0, 0)), high.unwrap_or(Point::new(0, 0)));
        let cell_nm = [(high.x - low.x) / CELLS + 1, (high.y - low.y) / CELLS + 1];
        let mut cover = Self { areas, low, cell_nm, cells: vec![Vec::new(); (CELLS * CELLS) as usize] };
        for number in 0..cover.areas.len() {
            for cell in cover.cells_of(&cover.areas[number].1) {
                cover.cells[cell].push(number as u32);
            }
        }
        cover
    }

    fn cells_of(&self, [low, high]: &[Point; 2]) -> impl Iterator<Item = usize> + use<> {
        // In 64 bits: bounds of another layer may lie far outside.
        let cell = |nm: i32, low_nm: i32, cell_nm: i32| {
            ((i64::from(nm) - i64::from(low_nm)) / i64::from(cell_nm)).clamp(0, i64::from(CELLS) - 1) as i32
        };
        let columns = cell(low.x, self.low.x, self.cell_nm[0])..=cell(high.x, self.low.x, self.cell_nm[0]);
        let rows = cell(low.y, self.low.y, self.cell_nm[1])..=cell(high.y, self.low.y, self.cell_nm[1]);
        rows.flat_map(move |row| columns.clone().map(move |column| (row * CELLS + column) as usize))
    }

    /// The areas whose bounds meet other bounds.
    fn near(&self, bounds: &[Point; 2]) -> Area {
        let mut found: Vec<u32> = self.cells_of(bounds).flat_map(|cell| self.cells[cell].iter().copied()).collect();
        found.sort_unstable();
        found.dedup();
        let [low, high] = bounds;
        let meets = |[other_low, other_high]: &[Point; 2]| {
            other_low.x <= high.x && other_high.x >= low.x && other_low.y <= high.y && other_high.y >= low.y
        };
        let areas = found.iter().map(|number| &self.areas[*number as usize]).filter(|(_, bounds)| meets(bounds));
        Area::from_shapes(areas.flat_map(|(area, _)| area.shapes().iter().cloned()).collect())
    }
}

/// The part of an area that the neighbouring layer does not cover. Strips narrower than a beam are left out: each layer of a slope has one.
pub(super) fn exposed(area: &Area, cover: &Cover, beam_um: f64) -> Area {
    let Some(bounds) = area.bounds_nm() else { return Area::default() };
    let open = area.subtract(&cover.near(&bounds));
    open.offset(-beam_um / 2.0).offset(beam_um / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rectangle(low: [f64; 2], high: [f64; 2]) -> Region {
        Region { outer: vec![low, [high[0], low[1]], high, [low[0], high[1]]], holes: Vec::new() }
    }

    #[test]
    fn what_sticks_out_is_exposed_and_slopes_are_not() {
        let area = Area::of(&rectangle([1000.0, 1000.0], [3000.0, 2000.0]));
        let exposed_um2 = |cover: &[Region]| exposed(&area, &Cover::new(cover), 60.0).area_um2();
        assert!((exposed_um2(&[]) - 2e6).abs() < 4.0 * 30.0 * 30.0, "all of it, but for rounded corners");
        assert_eq!(exposed_um2(&[rectangle([0.0, 0.0], [4000.0, 4000.0])]), 0.0);
        // A slope of 50 µm a layer.
        assert_eq!(exposed_um2(&[rectangle([1000.0, 1000.0], [2950.0, 2000.0])]), 0.0);
        let half = [rectangle([0.0, 0.0], [2000.0, 4000.0]), rectangle([900_000.0; 2], [900_050.0; 2])];
        assert!((exposed_um2(&half) - 1e6).abs() < 4.0 * 30.0 * 30.0);
    }
}
