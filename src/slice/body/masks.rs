//! Bodies as masks: one picture for each material, in which no pixel is lit twice. Where bodies overlap, a pixel belongs to the last of them.
//! `slice/mask_slicer.rs` draws them; `tests/materials/` compares them with the pictures of the whole.

use super::{Body, Brush, Cut, PixelBody};
use crate::layer::Depth;
use crate::slice::band::Band;
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::Effort;
use crate::stream::{Charge, MemoryBudget};

/// A body that is drawn as masks.
pub(in crate::slice) trait MaskBody: Body {
    /// Brushes for the plane last given to [`Body::advance`], one for each thread.
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn MaskBrush + '_>>;
}

/// Draws the masks of one body on one thread.
pub(in crate::slice) trait MaskBrush: Send {
    /// Merges the body into the bands of all materials, which are of the same rows.
    fn cover(&mut self, bands: &mut [Band<'_>]);
}

/// Most rows of a band of a body of one material.
const ROWS_PER_BAND: usize = 64;

/// A body of one material.
pub(super) struct OfMaterial {
    body: Box<dyn PixelBody>,
    material: usize,
    /// A band for each thread, and the bits of an owner of all pixels.
    bands: Vec<Vec<u8>>,
    _charge: Charge,
}

impl OfMaterial {
    /// The memory of its bands is charged to `budget`.
    ///
    /// # Errors
    /// [`SliceError`] if it is not free.
    pub(super) fn new(
        body: Box<dyn PixelBody>,
        material: usize,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let charge = budget.charge("the bands of a body of one material", Self::memory_bytes(plan, threads))?;
        Ok(Self { body, material, bands: vec![vec![0; band_bytes(plan)]; threads], _charge: charge })
    }

    /// Memory of the bands, bytes.
    pub(super) fn memory_bytes(plan: &SlicePlan, threads: usize) -> u64 {
        (band_bytes(plan) as u64).saturating_mul(threads as u64)
    }
}

fn band_bytes(plan: &SlicePlan) -> usize {
    plan.depth.stride_bytes(plan.raster.width_px) * ROWS_PER_BAND
}

impl Body for OfMaterial {
    fn rows_per_band(&self) -> usize {
        self.body.rows_per_band().min(ROWS_PER_BAND)
    }

    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        self.body.advance(z_um, workers)
    }

    fn active_count(&self) -> usize {
        self.body.active_count()
    }

    fn effort(&self) -> Effort {
        self.body.effort()
    }
}

impl MaskBody for OfMaterial {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn MaskBrush + '_>> {
        let material = self.material;
        let brushes = self.body.brushes(cut).into_iter().zip(&mut self.bands);
        brushes.map(|(brush, band)| Box::new(MaterialBrush { brush, material, band }) as Box<dyn MaskBrush>).collect()
    }
}

struct MaterialBrush<'a> {
    brush: Box<dyn Brush + 'a>,
    material: usize,
    band: &'a mut [u8],
}

impl MaskBrush for MaterialBrush<'_> {
    fn cover(&mut self, bands: &mut [Band<'_>]) {
        let Some(first) = bands.first() else { return };
        let (depth, rows) = (first.depth(), first.rows());
        let (first_row, stride_bytes) = (rows.first, rows.stride_bytes());
        let drawn = &mut self.band[..rows.count() * stride_bytes];
        self.brush.cover(&mut Band::dark(depth, first_row, drawn, stride_bytes));
        for (row, drawn) in drawn.chunks_exact(stride_bytes).enumerate() {
            let owns = |material: usize, _: usize| if material == self.material { 0xff } else { 0 };
            merge_row(bands, row, 0, drawn, owns);
        }
    }
}

/// Merges a stretch of a row, from byte `first` on, into the masks: each lit pixel of `drawn` goes to its owner, unless it is lit brighter already.
/// `owns` gives the bits of eight pixels that a material owns, by the material and the number of the eight within the stretch.
pub(super) fn merge_row(
    bands: &mut [Band<'_>],
    row: usize,
    first: usize,
    drawn: &[u8],
    owns: impl Fn(usize, usize) -> u8,
) {
    match bands.first().map(Band::depth) {
        Some(Depth::Bit) => {
            for (material, band) in bands.iter_mut().enumerate() {
                let mask = &mut band.rows_mut().row_mut(row)[first..first + drawn.len()];
                for (byte, (mask, drawn)) in mask.iter_mut().zip(drawn).enumerate() {
                    *mask = *mask & !drawn | drawn & owns(material, byte);
                }
            }
        }
        Some(Depth::Grey) => {
            for (pixel, drawn) in drawn.iter().enumerate().filter(|(_, drawn)| **drawn > 0) {
                let at = first + pixel;
                if bands.iter_mut().any(|band| band.rows_mut().row_mut(row)[at] > *drawn) {
                    continue;
                }
                for (material, band) in bands.iter_mut().enumerate() {
                    let is_owner = owns(material, pixel / 8) & 0x80 >> (pixel % 8) != 0;
                    band.rows_mut().row_mut(row)[at] = if is_owner { *drawn } else { 0 };
                }
            }
        }
        None => {}
    }
}
