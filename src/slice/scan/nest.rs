//! Makes regions of the rings of a layer: each outer ring with the holes in it. `contours` returns them.

use super::contour::{Crossing, PITCH};
use super::join::Rings;
use super::region::{Region, Ring};
use crate::layer::Raster;

/// From the picture's rows and columns to micrometres in the field.
#[derive(Clone, Copy, Debug)]
pub(super) struct Places {
    pixel_um: [f64; 2],
    /// Width and height of the area where the axis is mirrored.
    mirrored_um: [Option<f64>; 2],
}

impl Places {
    /// Those of a raster.
    pub(super) fn new(raster: &Raster) -> Self {
        let [width, height] = raster.area_um();
        let mirrored_um = [raster.mirror.x.then_some(width), raster.mirror.y.then_some(height)];
        Self { pixel_um: raster.pixel_um, mirrored_um }
    }

    /// Where a crossing lies.
    pub(super) fn point_um(&self, crossing: &Crossing) -> [f64; 2] {
        let mut at = [f64::from(crossing.x), f64::from(crossing.y)];
        at[crossing.along as usize] += f64::from(crossing.at) / PITCH;
        [0, 1].map(|axis| {
            // Row and column 1 are the first pixel's, whose centre is half a pitch from the low corner.
            let um = (at[axis] - 0.5) * self.pixel_um[axis];
            self.mirrored_um[axis].map_or(um, |side_um| side_um - um)
        })
    }
}

/// Memory of the regions of these rings, and of making them, bytes.
pub(super) fn bytes(rings: &Rings) -> u64 {
    let points: usize = rings.spans.iter().map(|span| (span.end - span.start) as usize).sum();
    let ring_bytes = size_of::<Region>() + size_of::<Ring>() + 2 * size_of::<u32>();
    (points * size_of::<[f64; 2]>() + rings.spans.len() * ring_bytes) as u64
}

/// The regions of these rings, in the order of their first pixels, row by row. Islands in holes are regions of their own.
pub(super) fn regions(rings: &Rings, places: &Places) -> Vec<Region> {
    let spans = &rings.spans;
    let is_outer = |number: usize| spans[number].outer as usize == number;
    let mut hole_counts = vec![0_u32; spans.len()];
    for number in (0..spans.len()).filter(|number| !is_outer(*number)) {
        hole_counts[spans[number].outer as usize] += 1;
    }
    let ring = |number: usize| -> Ring {
        let crossings = &rings.crossings[spans[number].start as usize..spans[number].end as usize];
        crossings.iter().map(|crossing| places.point_um(crossing)).collect()
    };
    let mut regions = Vec::with_capacity((0..spans.len()).filter(|number| is_outer(*number)).count());
    // The number of the region of each outer ring, which comes before its holes.
    let mut numbers = vec![0_u32; spans.len()];
    for number in 0..spans.len() {
        if is_outer(number) {
            numbers[number] = regions.len() as u32;
            regions.push(Region { outer: ring(number), holes: Vec::with_capacity(hole_counts[number] as usize) });
        } else {
            let region: &mut Region = &mut regions[numbers[spans[number].outer as usize] as usize];
            region.holes.push(ring(number));
        }
    }
    regions
}
