//! Where nothing lies above or below a region. `layer_plan` uses it.

use super::offset::{Area, Corners, Point, around, to_nm};
use super::region::Region;

/// Cells of the index along each axis. A layer of 50,000 regions has 50 in a cell.
const CELLS: i32 = 32;

/// The regions of a neighbouring layer, found by place.
pub(super) struct Cover {
    areas: Vec<(Area, Corners)>,
    grid: Grid,
    /// Numbers of the areas whose bounds touch each cell.
    cells: Vec<Vec<u32>>,
}

/// Where cells are.
#[derive(Clone, Copy)]
struct Grid {
    low: Point,
    /// Size of a cell, nanometres, at least 1.
    cell_nm: [i32; 2],
}

impl Grid {
    /// Around everything with these bounds.
    fn around(bounds: impl Iterator<Item = Corners>) -> Self {
        let [low, high] = bounds.reduce(around).unwrap_or([Point::new(0, 0); 2]);
        Self { low, cell_nm: [(high.x - low.x) / CELLS + 1, (high.y - low.y) / CELLS + 1] }
    }

    fn cells_of(&self, [low, high]: &Corners) -> impl Iterator<Item = usize> + use<> {
        // In 64 bits: bounds of another layer may lie far outside.
        let cell = |nm: i32, low_nm: i32, cell_nm: i32| {
            ((i64::from(nm) - i64::from(low_nm)) / i64::from(cell_nm)).clamp(0, i64::from(CELLS) - 1) as i32
        };
        let columns = cell(low.x, self.low.x, self.cell_nm[0])..=cell(high.x, self.low.x, self.cell_nm[0]);
        let rows = cell(low.y, self.low.y, self.cell_nm[1])..=cell(high.y, self.low.y, self.cell_nm[1]);
        rows.flat_map(move |row| columns.clone().map(move |column| (row * CELLS + column) as usize))
    }
}

impl Cover {
    /// Indexes the regions of a layer.
    pub(super) fn new(regions: &[Region]) -> Self {
        let areas: Vec<(Area, Corners)> =
            regions.iter().map(Area::of).filter_map(|area| area.bounds_nm().map(|bounds| (area, bounds))).collect();
        let grid = Grid::around(areas.iter().map(|(_, bounds)| *bounds));
        let mut cells = vec![Vec::new(); (CELLS * CELLS) as usize];
        for (number, (_, bounds)) in areas.iter().enumerate() {
            for cell in grid.cells_of(bounds) {
                cells[cell].push(number as u32);
            }
        }
        Self { areas, grid, cells }
    }

    /// The most memory that the index of these regions takes, bytes. Lists grow by doubling.
    pub(super) fn bytes(regions: &[Region]) -> u64 {
        let bounds = || regions.iter().filter_map(bounds_nm);
        let grid = Grid::around(bounds());
        let touched: usize = bounds().map(|bounds| grid.cells_of(&bounds).count()).sum();
        let (rings, points) = regions
            .iter()
            .flat_map(Region::rings)
            .fold((0, 0), |(rings, points), ring| (rings + 1, points + ring.len()));
        let of_areas = points * size_of::<Point>() + (rings + regions.len()) * size_of::<Vec<Point>>();
        let of_lists = 3 * regions.len() * size_of::<(Area, Corners)>() + 3 * touched * size_of::<u32>();
        // A list begins with room for four.
        let of_cells = (CELLS * CELLS) as usize * (size_of::<Vec<u32>>() + 4 * size_of::<u32>());
        (of_areas + of_lists + of_cells) as u64
    }

    /// The areas whose bounds meet other bounds.
    fn near(&self, bounds: &Corners) -> impl Iterator<Item = &Area> {
        let mut found: Vec<u32> =
            self.grid.cells_of(bounds).flat_map(|cell| self.cells[cell].iter().copied()).collect();
        found.sort_unstable();
        found.dedup();
        let [low, high] = *bounds;
        let meets = move |[other_low, other_high]: &Corners| {
            other_low.x <= high.x && other_high.x >= low.x && other_low.y <= high.y && other_high.y >= low.y
        };
        let areas = found.into_iter().map(|number| &self.areas[number as usize]);
        areas.filter(move |(_, bounds)| meets(bounds)).map(|(area, _)| area)
    }

    /// Number of points of the areas whose bounds meet those of a region.
    pub(super) fn points_near(&self, region: &Region) -> u64 {
        let Some(bounds) = bounds_nm(region) else { return 0 };
        self.near(&bounds).flat_map(Area::rings).map(Vec::len).sum::<usize>() as u64
    }
}

/// The corners of a region.
fn bounds_nm(region: &Region) -> Option<Corners> {
    region.outer.iter().map(|point| [to_nm(*point); 2]).reduce(around)
}

/// The part of an area that the neighbouring layer does not cover. Strips narrower than a beam are left out: each layer of a slope has one.
pub(super) fn exposed(area: &Area, cover: &Cover, beam_um: f64) -> Area {
    let Some(bounds) = area.bounds_nm() else { return Area::default() };
    let near = cover.near(&bounds).flat_map(|near| near.shapes().iter().cloned());
    let open = area.subtract(&Area::from_shapes(near.collect()));
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
