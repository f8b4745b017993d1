//! Draws the active struts of a band on a strip of rows that stays in the cache. `tests/slice.rs` compares what it draws.

use super::active::ActiveSet;
use crate::layer::Depth;
use crate::slice::band::{Band, FieldBand};
use crate::slice::body::{Brush, FieldBrush};
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{Effort, FieldShape, Grid, InstructionSet, PixelShape, Plane, Shape, Strip};
use crate::stream::{Charge, MemoryBudget};

/// Largest strip, bytes, unless a single group of rows is longer. Compared with a strip of half this size it saves a tenth of the
/// instructions, because each strut is examined and cut by fewer bands. That outweighs that it no longer fits a level-2 cache of
/// 512 KiB. A strip of twice this size gains nothing.
const MAX_STRIP_BYTES: usize = 768 << 10;

/// Most groups of rows in a strip. Without this limit a small picture would be a single band, and leave no work for other threads.
const MAX_GROUPS: usize = 8;

/// Rows in a group: shapes prepare eight rows at once.
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
        halo: usize,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let charge = budget.charge("the strips of the rasteriser", Self::memory_bytes(plan, halo, threads))?;
        let width = plan.raster.width_px as usize;
        let rows_per_band = rows_per_band::<S>(plan, halo);
        let strips = (0..threads).map(|_| Strip::new(width, rows_per_band, halo)).collect();
        Ok(Self { rows_per_band, instructions, strips, _charge: charge })
    }

    /// Memory of the strips, bytes.
    pub(super) fn memory_bytes(plan: &SlicePlan, halo: usize, threads: usize) -> u64 {
        let (width, rows) = (plan.raster.width_px as usize, rows_per_band::<S>(plan, halo));
        Strip::<S::Cell>::bytes(width, rows, halo).saturating_mul(threads as u64)
    }

    /// Rows of a band.
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

    /// Work since the strips were made.
    pub(super) fn effort(&self) -> Effort {
        self.strips.iter().map(Strip::effort).sum()
    }
}

/// Rows of a band. Together with the halo they are a whole number of groups.
pub(super) fn rows_per_band<S: Shape>(plan: &SlicePlan, halo: usize) -> usize {
    let row_bytes = plan.raster.width_px as usize * size_of::<S::Cell>();
    let groups = MAX_STRIP_BYTES / (row_bytes * ROW_GROUP);
    groups.clamp(1, MAX_GROUPS) * ROW_GROUP - 2 * halo
}

/// Rows and columns around a band that its pixels depend on: only grey reads neighbouring pixels.
pub(super) fn halo<S: PixelShape>(depth: Depth) -> usize {
    match depth {
        Depth::Bit => 0,
        Depth::Grey => S::HALO,
    }
}

/// The brush of one thread.
pub(super) struct StripBrush<'a, S: Shape> {
    pub(super) active: &'a ActiveSet,
    pub(super) plane: Plane,
    pub(super) instructions: InstructionSet,
    pub(super) strip: &'a mut Strip<S::Cell>,
}

/// The brush of one thread that draws a field.
pub(super) struct FieldStripBrush<'a, S: Shape> {
    pub(super) strip: StripBrush<'a, S>,
    pub(super) scale: Scale,
}

/// From cells to a field.
#[derive(Clone, Copy)]
pub(super) struct Scale {
    /// Micrometres of excess for each unit of a cell.
    excess_um: f32,
    /// The excess where no strut reaches, micrometres.
    outside_um: f32,
}

impl Scale {
    /// For pixels of this grid, whose unit of length is `unit_um`, and struts with radii up to `radius_um`.
    pub(super) fn of<S: FieldShape>(grid: &Grid, unit_um: f64, radius_um: f64) -> Self {
        let excess_um = S::excess_um(unit_um, radius_um);
        let pitch_um = grid.dx.abs().max(grid.dy.abs()) * unit_um;
        Self { excess_um, outside_um: S::outside_um(excess_um, pitch_um) }
    }
}

impl<S: Shape> StripBrush<'_, S> {
    /// Draws `count` rows of the grid from `first` on, and the rows of the halo, on the strip.
    pub(super) fn draw(&mut self, first: usize, count: usize, halo: usize) {
        self.strip.begin(first, count);
        let rows = first as i64 - halo as i64..(first + count + halo) as i64;
        S::draw(self.instructions, self.active.blocks(rows), &self.plane, self.strip);
    }
}

impl<S: PixelShape> Brush for StripBrush<'_, S> {
    fn cover(&mut self, band: &mut Band<'_>) {
        let rows = band.rows();
        self.draw(rows.first, rows.count(), halo::<S>(band.depth()));
        merge_pixels::<S>(self.instructions, self.strip, self.plane.grid.width, band);
    }
}

/// Merges what is drawn on a strip into a band of `width` pixels.
pub(super) fn merge_pixels<S: PixelShape>(
    instructions: InstructionSet,
    strip: &Strip<S::Cell>,
    width: usize,
    band: &mut Band<'_>,
) {
    let depth = band.depth();
    for (row, out) in band.rows_mut().each_mut().enumerate() {
        for pixels in strip.used_pixels(width) {
            match depth {
                Depth::Bit => {
                    let bytes = pixels.start / 8..pixels.end.div_ceil(8);
                    S::merge_bits(instructions, strip, row, bytes.start, &mut out[bytes]);
                }
                Depth::Grey => S::merge_coverage(instructions, strip, row, pixels.start, &mut out[pixels]),
            }
        }
    }
}

impl<S: FieldShape> FieldBrush for FieldStripBrush<'_, S> {
    fn raise(&mut self, band: &mut FieldBand<'_>) {
        self.strip.draw(band.first, band.count(), 0);
        merge_field::<S>(self.strip.strip, &self.scale, self.strip.plane.grid.width, band);
    }
}

/// Raises a band of `width` pixels to what is drawn on a strip.
pub(super) fn merge_field<S: FieldShape>(
    strip: &Strip<S::Cell>,
    scale: &Scale,
    width: usize,
    band: &mut FieldBand<'_>,
) {
    for (row, out) in band.each_mut().enumerate() {
        // Everywhere, so that the excess does not depend on which cells a kernel happened to touch.
        for excess in &mut *out {
            *excess = excess.max(scale.outside_um);
        }
        for pixels in strip.used_pixels(width) {
            S::merge_excess(strip, row, pixels.start, scale.excess_um, &mut out[pixels]);
        }
    }
}
