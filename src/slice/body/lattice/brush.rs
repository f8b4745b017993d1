//! Strips of rows that stay in the cache while the struts of a band are drawn on them.

use super::active::ActiveSet;
use crate::layer::Depth;
use crate::slice::band::Band;
use crate::slice::body::Brush;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{Effort, InstructionSet, Plane, Shape, Strip};
use crate::stream::{Charge, MemoryBudget};

/// Bytes of a strip at most, where its rows are not too long for one group. Compared with half as much it saves a tenth of the
/// instructions, as each strut is looked at and cut by fewer bands; that outweighs what no longer fits a level-2 cache of 512 KiB.
/// Twice as much gains nothing.
const STRIP_BYTES: usize = 768 << 10;

/// Groups of rows in a strip at most: a picture of few pixels would otherwise be one band, and leave other threads nothing.
const MOST_GROUPS: usize = 8;

/// Shapes set up rows in eights.
const ROW_GROUP: usize = 8;

/// The strips of all threads.
pub(super) struct Strips<S: Shape> {
    rows_per_band: usize,
    instructions: InstructionSet,
    strips: Vec<Strip<S::Cell>>,
    _charge: Charge,
}

impl<S: Shape> Strips<S> {
    pub(super) fn new(
        plan: &SlicePlan,
        instructions: InstructionSet,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let charge = budget.charge("the strips of the rasteriser", Self::memory_bytes(plan, threads))?;
        let (width, halo) = (plan.raster.width_px as usize, halo::<S>(plan.depth));
        let rows_per_band = rows_per_band::<S>(plan);
        let strips = (0..threads).map(|_| Strip::new(width, rows_per_band, halo)).collect();
        Ok(Self { rows_per_band, instructions, strips, _charge: charge })
    }

    /// Bytes the strips take.
    pub(super) fn memory_bytes(plan: &SlicePlan, threads: usize) -> u64 {
        let (width, rows) = (plan.raster.width_px as usize, rows_per_band::<S>(plan));
        Strip::<S::Cell>::bytes(width, rows, halo::<S>(plan.depth)).saturating_mul(threads as u64)
    }

    /// Rows drawn at once.
    pub(super) fn rows_per_band(&self) -> usize {
        self.rows_per_band
    }

    /// The instruction set.
    pub(super) fn instructions(&self) -> InstructionSet {
        self.instructions
    }

    /// One strip for each thread.
    pub(super) fn each_mut(&mut self) -> impl Iterator<Item = &mut Strip<S::Cell>> {
        self.strips.iter_mut()
    }

    /// What drawing has taken so far.
    pub(super) fn effort(&self) -> Effort {
        self.strips.iter().map(Strip::effort).sum()
    }
}

/// Rows drawn at once; with the halo's a whole number of groups.
pub(super) fn rows_per_band<S: Shape>(plan: &SlicePlan) -> usize {
    let row_bytes = plan.raster.width_px as usize * size_of::<S::Cell>();
    let groups = STRIP_BYTES / (row_bytes * ROW_GROUP);
    groups.clamp(1, MOST_GROUPS) * ROW_GROUP - 2 * halo::<S>(plan.depth)
}

/// Only grey looks at neighbours.
fn halo<S: Shape>(depth: Depth) -> usize {
    match depth {
        Depth::Bit => 0,
        Depth::Grey => S::HALO,
    }
}

/// Draws the struts within reach of a plane on the strip of one thread.
pub(super) struct StripBrush<'a, S: Shape> {
    pub(super) active: &'a ActiveSet,
    pub(super) plane: Plane,
    pub(super) instructions: InstructionSet,
    pub(super) strip: &'a mut Strip<S::Cell>,
}

impl<S: Shape> StripBrush<'_, S> {
    /// Draws the rows of the grid from `first` on, and those of a halo round them, on the strip.
    fn draw(&mut self, first: usize, count: usize, halo: usize) {
        self.strip.begin(first, count);
        let rows = first as i64 - halo as i64..(first + count + halo) as i64;
        S::draw(self.instructions, self.active.blocks(rows), &self.plane, self.strip);
    }
}

impl<S: Shape> Brush for StripBrush<'_, S> {
    fn cover(&mut self, band: &mut Band<'_>) {
        let width = self.plane.grid.width;
        match band {
            Band::Bits(rows) => {
                self.draw(rows.first, rows.count(), halo::<S>(Depth::Bit));
                for (row, out) in rows.each_mut().enumerate() {
                    for pixels in self.strip.used_pixels(width) {
                        let bytes = pixels.start / 8..pixels.end.div_ceil(8);
                        S::merge_bits(self.instructions, self.strip, row, bytes.start, &mut out[bytes]);
                    }
                }
            }
            Band::Grey(rows) => {
                self.draw(rows.first, rows.count(), halo::<S>(Depth::Grey));
                for (row, out) in rows.each_mut().enumerate() {
                    for pixels in self.strip.used_pixels(width) {
                        S::merge_coverage(self.instructions, self.strip, row, pixels.start, &mut out[pixels]);
                    }
                }
            }
        }
    }
}
