//! The topology of a picture by flood fill, and which region of a layer each pixel lies in.

use layerd::layer::Bitmap;
use layerd::slice::SlicePlan;
use layerd::slice::scan::Region;

use crate::slice_part::lit;

/// The connected pieces of a picture with a frame of dark pixels around it.
#[derive(Clone)]
pub(crate) struct Pieces {
    width: usize,
    height: usize,
    /// For each pixel, those of the frame included, the number of its piece.
    piece: Vec<usize>,
    pub(crate) solid_count: usize,
    /// Dark pieces that the frame does not belong to.
    pub(crate) hole_count: usize,
}

impl Pieces {
    /// Of neighbours along rows and columns; and of two pixels that touch at a corner between two of the other kind, the solid ones if
    /// `is_joined` says so of the corner at the low end of (x, y), else the dark ones.
    pub(crate) fn of(bitmap: &Bitmap, mut is_joined: impl FnMut(u32, u32) -> bool) -> Self {
        let (width, height) = (bitmap.width_px() as usize + 2, bitmap.height_px() as usize + 2);
        let is_lit = |x: usize, y: usize| {
            let inside = (1..width - 1).contains(&x) && (1..height - 1).contains(&y);
            inside && lit(bitmap, x as u32 - 1, y as u32 - 1)
        };
        let mut pieces = Self { width, height, piece: (0..width * height).collect(), solid_count: 0, hole_count: 0 };
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            for (other_x, other_y) in [(x + 1, y), (x, y + 1)] {
                if other_x < width && other_y < height && is_lit(x, y) == is_lit(other_x, other_y) {
                    pieces.unite(y * width + x, other_y * width + other_x);
                }
            }
            if x == 0 || y == 0 {
                continue;
            }
            let corners = [is_lit(x - 1, y - 1), is_lit(x, y - 1), is_lit(x, y), is_lit(x - 1, y)];
            if corners[0] == corners[2] && corners[1] == corners[3] && corners[0] != corners[1] {
                if corners[0] == is_joined(x as u32 - 1, y as u32 - 1) {
                    pieces.unite((y - 1) * width + x - 1, y * width + x);
                } else {
                    pieces.unite((y - 1) * width + x, y * width + x - 1);
                }
            }
        }
        for at in 0..width * height {
            if pieces.root(at) == at {
                let solid = is_lit(at % width, at / width);
                pieces.solid_count += usize::from(solid);
                pieces.hole_count += usize::from(!solid && at != 0);
            }
        }
        pieces
    }

    fn root(&mut self, mut at: usize) -> usize {
        while self.piece[at] != at {
            self.piece[at] = self.piece[self.piece[at]];
            at = self.piece[at];
        }
        at
    }

    /// The lower number stays, so that the frame's piece has number 0.
    fn unite(&mut self, one: usize, other: usize) {
        let (one, other) = (self.root(one), self.root(other));
        self.piece[one.max(other)] = one.min(other);
    }

    /// A number of the piece of a pixel.
    fn of_pixel(&mut self, x: usize, y: usize) -> usize {
        debug_assert!(x + 2 < self.width && y + 2 < self.height);
        self.root((y + 1) * self.width + x + 1)
    }
}

/// For each pixel, the numbers of the regions that its centre lies in, found by parity along its row.
fn regions_of_pixels(regions: &[Region], plan: &SlicePlan) -> Vec<Vec<usize>> {
    let (width, height) = (plan.raster.width_px as usize, plan.raster.height_px as usize);
    let place = |axis: usize, at: usize| {
        let um = (at as f64 + 0.5) * plan.raster.pixel_um[axis];
        let mirrored = [plan.raster.mirror.x, plan.raster.mirror.y][axis];
        if mirrored { plan.raster.area_um()[axis] - um } else { um }
    };
    let mut found = vec![Vec::new(); width * height];
    for (number, region) in regions.iter().enumerate() {
        for y in 0..height {
            let at_y = place(1, y);
            let mut cuts: Vec<f64> = region
                .rings()
                .flat_map(|ring| super::rings::segments(ring))
                .filter(|[a, b]| (a[1] <= at_y) != (b[1] <= at_y))
                .map(|[a, b]| a[0] + (at_y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
                .collect();
            if cuts.is_empty() {
                continue;
            }
            cuts.sort_by(f64::total_cmp);
            for x in 0..width {
                let at_x = place(0, x);
                if cuts.iter().filter(|cut| **cut < at_x).count() % 2 == 1 {
                    found[y * width + x].push(number);
                }
            }
        }
    }
    found
}

/// Says what is wrong unless the regions are the solid pieces of the picture, and their holes its holes.
pub(crate) fn problem(regions: &[Region], bitmap: &Bitmap, plan: &SlicePlan, mut pieces: Pieces) -> Option<String> {
    let hole_count: usize = regions.iter().map(|region| region.holes.len()).sum();
    if (regions.len(), hole_count) != (pieces.solid_count, pieces.hole_count) {
        let (solid, holes) = (pieces.solid_count, pieces.hole_count);
        return Some(format!("{} regions of {solid}, {hole_count} holes of {holes}", regions.len()));
    }
    let mut piece_of_region = vec![None; regions.len()];
    for (at, found) in regions_of_pixels(regions, plan).into_iter().enumerate() {
        let (x, y) = (at % bitmap.width_px() as usize, at / bitmap.width_px() as usize);
        match (lit(bitmap, x as u32, y as u32), &found[..]) {
            (false, []) => {}
            (true, [region]) => {
                let piece = pieces.of_pixel(x, y);
                if *piece_of_region[*region].get_or_insert(piece) != piece {
                    return Some(format!("region {region} has pixels of two pieces, one is {x}, {y}"));
                }
            }
            (solid, found) => return Some(format!("pixel {x}, {y} is solid: {solid}, it lies in regions {found:?}")),
        }
    }
    None
}
