//! One layer's pixels: bands of rows, shared by threads, each drawn on a strip that stays in the cache.

use super::active::ActiveSet;
use super::workers::Workers;
use super::{SliceError, SlicePlan};
use crate::layer::{Bitmap, Depth};
use crate::solid::{Effort, Path, Plane, Shape, Strip};
use crate::stream::{Charge, MemoryBudget};

/// Bytes of a strip at most, where its rows are not too long for one group. Compared with half as much it saves a tenth of the
/// instructions, as each strut is looked at and cut by fewer bands; that outweighs what no longer fits a level-2 cache of 512 KiB.
/// Twice as much gains nothing.
const STRIP_BYTES: usize = 768 << 10;

/// Groups of rows in a strip at most: a picture of few pixels would otherwise be one band, and leave other threads nothing.
const MOST_GROUPS: usize = 8;

/// Shapes set up rows in eights.
const ROW_GROUP: usize = 8;

/// Draws layers of one size with shapes of one kind.
pub(super) struct Drawing<S: Shape> {
    rows_per_band: usize,
    path: Path,
    /// One for each thread.
    strips: Vec<Strip<S::Cell>>,
    _charge: Charge,
}

impl<S: Shape> Drawing<S> {
    pub(super) fn new(plan: &SlicePlan, path: Path, threads: usize, budget: &MemoryBudget) -> Result<Self, SliceError> {
        let charge = budget.charge("the strips of the rasteriser", Self::memory_bytes(plan, threads))?;
        let (width, halo) = (plan.raster.width_px as usize, halo::<S>(plan.depth));
        let rows_per_band = Self::rows_per_band(plan);
        let strips = (0..threads).map(|_| Strip::new(width, rows_per_band, halo)).collect();
        Ok(Self { rows_per_band, path, strips, _charge: charge })
    }

    /// Bytes a drawing takes.
    pub(super) fn memory_bytes(plan: &SlicePlan, threads: usize) -> u64 {
        let strip =
            Strip::<S::Cell>::bytes(plan.raster.width_px as usize, Self::rows_per_band(plan), halo::<S>(plan.depth));
        strip.saturating_mul(threads as u64)
    }

    /// Rows drawn at once; with the halo's a whole number of groups.
    pub(super) fn rows_per_band(plan: &SlicePlan) -> usize {
        let row_bytes = plan.raster.width_px as usize * size_of::<S::Cell>();
        let groups = STRIP_BYTES / (row_bytes * ROW_GROUP);
        groups.clamp(1, MOST_GROUPS) * ROW_GROUP - 2 * halo::<S>(plan.depth)
    }

    /// What drawing has taken so far.
    pub(super) fn effort(&self) -> Effort {
        let strips = self.strips.iter().map(Strip::effort);
        strips.fold(Effort::default(), |sum, one| Effort {
            looks: sum.looks + one.looks,
            drawn: sum.drawn + one.drawn,
            rows: sum.rows + one.rows,
            evaluations: sum.evaluations + one.evaluations,
        })
    }

    /// Draws the plane over whatever the bitmap held.
    pub(super) fn draw(&mut self, active: &ActiveSet, plane: &Plane, workers: &Workers, bitmap: &mut Bitmap) {
        let (depth, stride) = (bitmap.depth(), bitmap.stride_bytes());
        let (rows_per_band, path, halo) = (self.rows_per_band, self.path, halo::<S>(depth) as i64);
        let bands = bitmap.data_mut().chunks_mut(stride * rows_per_band).enumerate();
        workers.run(bands, &mut self.strips, |strip, (band, picture)| {
            let (first, count) = (band * rows_per_band, picture.len() / stride);
            strip.begin(first, count);
            let blocks = active.blocks(first as i64 - halo..(first + count) as i64 + halo);
            S::draw(path, blocks, plane, strip);
            for (row, out) in picture.chunks_exact_mut(stride).enumerate() {
                finish_row::<S>(path, strip, row, depth, plane.grid.width, out);
            }
        });
    }
}
/// Only grey looks at neighbours.
fn halo<S: Shape>(depth: Depth) -> usize {
    match depth {
        Depth::Bit => 0,
        Depth::Grey => S::HALO,
    }
}

/// From a strip's row to the picture's bytes.
fn finish_row<S: Shape>(path: Path, strip: &Strip<S::Cell>, row: usize, depth: Depth, width: usize, out: &mut [u8]) {
    out.fill(0);
    for pixels in strip.used_pixels(width) {
        match depth {
            Depth::Bit => {
                let bytes = pixels.start / 8..pixels.end.div_ceil(8);
                S::pack_bits(path, strip, row, bytes.start, &mut out[bytes]);
            }
            Depth::Grey => S::coverage(path, strip, row, pixels.start, &mut out[pixels]),
        }
    }
    if depth == Depth::Bit
        && !width.is_multiple_of(8)
        && let Some(last) = out.last_mut()
    {
        *last &= 0xff << (8 - width % 8);
    }
}
