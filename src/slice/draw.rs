//! One layer's pixels: bands of rows, shared by threads, each drawn on a strip that stays in the cache.

use crossbeam::channel;

use super::bands::Bands;
use super::{Bitmap, Depth, SliceError, SlicePlan};
use crate::solid::{Grid, Path, Shape, Strip};
use crate::stream::{Charge, MemoryBudget};

/// A strip shall leave room in a usual level-2 cache of 512 KiB. Fewer, larger strips set each strut up less often.
const STRIP_BYTES: usize = 384 << 10;

/// Shapes set up rows in eights.
const ROW_GROUP: usize = 8;

/// Draws layers of one size with shapes of one kind.
pub(super) struct Drawing<S: Shape> {
    bands: Bands,
    rows_per_band: usize,
    path: Path,
    /// One for each thread.
    strips: Vec<Strip<S::Cell>>,
    _charge: Charge,
}

/// The plane and its pixels, in the shapes' unit of length.
#[derive(Clone, Copy)]
pub(super) struct Plane {
    pub(super) grid: Grid,
    pub(super) z: f64,
}

impl<S: Shape> Drawing<S> {
    pub(super) fn new(
        plan: &SlicePlan,
        path: Path,
        peak_active: u64,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let bytes = Self::memory_bytes(plan, peak_active, threads);
        let charge = budget.charge("the strips and strut lists of the rasteriser", bytes)?;
        let (width, halo) = (plan.raster.width_px as usize, halo::<S>(plan.depth));
        let rows_per_band = Self::rows_per_band(width, halo);
        Ok(Self {
            bands: Bands::new(plan.raster.height_px as usize, rows_per_band, halo),
            rows_per_band,
            path,
            strips: (0..threads).map(|_| Strip::new(width, rows_per_band, halo)).collect(),
            _charge: charge,
        })
    }

    /// Bytes a drawing takes at most.
    pub(super) fn memory_bytes(plan: &SlicePlan, peak_active: u64, threads: usize) -> u64 {
        let (width, height) = (plan.raster.width_px as usize, plan.raster.height_px as usize);
        let halo = halo::<S>(plan.depth);
        let rows_per_band = Self::rows_per_band(width, halo);
        let strips = Strip::<S::Cell>::bytes(width, rows_per_band, halo).saturating_mul(threads as u64);
        Bands::memory_bytes(peak_active, height, rows_per_band).saturating_add(strips)
    }

    /// With the halo's rows a whole number of groups.
    fn rows_per_band(width: usize, halo: usize) -> usize {
        let groups = STRIP_BYTES / (width * size_of::<S::Cell>() * ROW_GROUP);
        groups.clamp(1, 8) * ROW_GROUP - 2 * halo
    }

    /// Draws the plane over whatever the bitmap held.
    pub(super) fn draw(&mut self, active: &[S], plane: &Plane, bitmap: &mut Bitmap) {
        let (depth, stride) = (bitmap.depth(), bitmap.stride_bytes());
        let band_bytes = stride * self.rows_per_band;
        self.bands.begin_layer(active, &plane.grid, plane.z);
        while let Some(round) = self.bands.next_round() {
            let first_byte = (round.start * band_bytes).min(bitmap.data().len());
            let pictures = bitmap.data_mut()[first_byte..].chunks_mut(band_bytes);
            let (sender, queue) = channel::bounded(round.len());
            for work in round.zip(pictures) {
                // Never full: it was made for this round.
                let _ = sender.try_send(work);
            }
            let (bands, rows_per_band, path) = (&self.bands, self.rows_per_band, self.path);
            let work = |strip: &mut Strip<S::Cell>| {
                for (band, picture) in queue.try_iter() {
                    let rows = picture.len() / stride;
                    strip.begin(band * rows_per_band, rows);
                    S::draw(path, active, bands.struts(band), &plane.grid, plane.z, strip);
                    for (row, out) in picture.chunks_exact_mut(stride).enumerate() {
                        finish_row::<S>(path, strip, row, depth, plane.grid.width, out);
                    }
                }
            };
            let Some((own, others)) = self.strips.split_first_mut() else { return };
            std::thread::scope(|scope| {
                let work = &work;
                for strip in others {
                    scope.spawn(move || work(strip));
                }
                work(own);
            });
        }
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
    let pixels = strip.used_pixels(width);
    match depth {
        Depth::Bit => {
            let bytes = pixels.start / 8..pixels.end.div_ceil(8);
            out[..bytes.start].fill(0);
            out[bytes.end..].fill(0);
            S::pack_bits(path, strip, row, bytes.start, &mut out[bytes.clone()]);
            if bytes.end == out.len() && !width.is_multiple_of(8) {
                out[bytes.end - 1] &= 0xff << (8 - width % 8);
            }
        }
        Depth::Grey => {
            out[..pixels.start].fill(0);
            out[pixels.end..].fill(0);
            S::coverage(path, strip, row, pixels.start, &mut out[pixels]);
        }
    }
}
