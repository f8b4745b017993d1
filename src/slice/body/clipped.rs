//! A lattice that a surface clips, as a body: both are drawn on bands of their own, and what is left of the lattice is merged into that of
//! the layer. `tests/clipped/` compares it with the two alone.

use super::surface::ROWS_PER_BAND;
use super::{Body, Brush, Cut, FieldBody, FieldBrush, PixelBody};
use crate::buildfile::Keeps;
use crate::layer::Depth;
use crate::slice::band::{Band, FieldBand};
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::Effort;
use crate::stream::{Charge, MemoryBudget};

/// A lattice, and the surface that clips it. `T` is what a band consists of.
struct Clipped<B: Body + ?Sized, T> {
    lattice: Box<B>,
    keeps: Keeps,
    clip: Box<B>,
    /// A band of the lattice and one of the surface for each thread.
    bands: Vec<[Vec<T>; 2]>,
    _charge: Charge,
}

/// Such a body as pixels. The memory of its bands is charged to `budget`.
///
/// # Errors
/// [`SliceError`] if the memory is not free.
pub(super) fn pixels(
    lattice: Box<dyn PixelBody>,
    keeps: Keeps,
    clip: Box<dyn PixelBody>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn PixelBody>, SliceError> {
    let charge = budget.charge(WHAT, pixels_memory_bytes(plan, threads))?;
    let bands = bands(threads, pixels_band(plan));
    Ok(Box::new(Clipped { lattice, keeps, clip, bands, _charge: charge }))
}

/// As [`pixels`], as a field.
///
/// # Errors
/// As [`pixels`].
pub(super) fn field(
    lattice: Box<dyn FieldBody>,
    keeps: Keeps,
    clip: Box<dyn FieldBody>,
    plan: &SlicePlan,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<Box<dyn FieldBody>, SliceError> {
    let charge = budget.charge(WHAT, field_memory_bytes(plan, threads))?;
    let bands = bands(threads, field_band(plan));
    Ok(Box::new(Clipped { lattice, keeps, clip, bands, _charge: charge }))
}

/// Two bands of so many elements for each thread.
fn bands<T: Clone + Default>(threads: usize, length: usize) -> Vec<[Vec<T>; 2]> {
    (0..threads).map(|_| [(); 2].map(|()| vec![T::default(); length])).collect()
}

const WHAT: &str = "the bands of clipped lattices";

/// Memory that [`pixels`] charges, bytes.
pub(super) fn pixels_memory_bytes(plan: &SlicePlan, threads: usize) -> u64 {
    (2 * pixels_band(plan) as u64).saturating_mul(threads as u64)
}

/// Memory that [`field`] charges, bytes.
pub(super) fn field_memory_bytes(plan: &SlicePlan, threads: usize) -> u64 {
    (2 * size_of::<f32>() as u64 * field_band(plan) as u64).saturating_mul(threads as u64)
}

fn pixels_band(plan: &SlicePlan) -> usize {
    plan.depth.stride_bytes(plan.raster.width_px) * ROWS_PER_BAND
}

fn field_band(plan: &SlicePlan) -> usize {
    plan.raster.width_px as usize * ROWS_PER_BAND
}

impl<B: Body + ?Sized, T: Send> Body for Clipped<B, T> {
    fn rows_per_band(&self) -> usize {
        self.lattice.rows_per_band().min(self.clip.rows_per_band()).min(ROWS_PER_BAND)
    }

    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError> {
        self.lattice.advance(z_um, workers)?;
        self.clip.advance(z_um, workers)
    }

    fn active_count(&self) -> usize {
        self.lattice.active_count() + self.clip.active_count()
    }

    fn effort(&self) -> Effort {
        [self.lattice.effort(), self.clip.effort()].into_iter().sum()
    }
}

/// The brush of one thread: `B` draws lattice and surface.
struct ClippedBrush<'a, B: ?Sized, T> {
    lattice: Box<B>,
    keeps: Keeps,
    clip: Box<B>,
    bands: &'a mut [Vec<T>; 2],
}

/// The brushes of all threads, from those of lattice and surface.
fn brushes<'a, B: ?Sized, T>(
    lattice: Vec<Box<B>>,
    keeps: Keeps,
    clip: Vec<Box<B>>,
    bands: &'a mut [[Vec<T>; 2]],
) -> impl Iterator<Item = ClippedBrush<'a, B, T>> {
    let both = lattice.into_iter().zip(clip).zip(bands);
    both.map(move |((lattice, clip), bands)| ClippedBrush { lattice, keeps, clip, bands })
}

impl PixelBody for Clipped<dyn PixelBody, u8> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn Brush + '_>> {
        let Self { lattice, keeps, clip, bands, .. } = self;
        let brushes = brushes(lattice.brushes(cut), *keeps, clip.brushes(cut), bands);
        brushes.map(|brush| Box::new(brush) as Box<dyn Brush>).collect()
    }
}

impl Brush for ClippedBrush<'_, dyn Brush + '_, u8> {
    fn cover(&mut self, band: &mut Band<'_>) {
        let (depth, rows) = match band {
            Band::Bits(rows) => (Depth::Bit, rows),
            Band::Grey(rows) => (Depth::Grey, rows),
        };
        let (first, stride_bytes) = (rows.first, rows.stride_bytes());
        let length = rows.count() * stride_bytes;
        let [lattice, clip] = self.bands.each_mut().map(|band| &mut band[..length]);
        self.lattice.cover(&mut Band::dark(depth, first, lattice, stride_bytes));
        self.clip.cover(&mut Band::dark(depth, first, clip, stride_bytes));
        // The complement of bits is that of 255, too.
        if self.keeps == Keeps::Outside {
            clip.iter_mut().for_each(|byte| *byte = 255 - *byte);
        }
        let rows_of_both = lattice.chunks_exact(stride_bytes).zip(clip.chunks_exact(stride_bytes));
        for (row, (lattice, clip)) in rows.each_mut().zip(rows_of_both) {
            let bytes = row.iter_mut().zip(lattice.iter().zip(clip));
            match depth {
                Depth::Bit => bytes.for_each(|(out, (lattice, clip))| *out |= lattice & clip),
                Depth::Grey => bytes.for_each(|(out, (lattice, clip))| *out = (*out).max(*lattice.min(clip))),
            }
        }
    }
}

impl FieldBody for Clipped<dyn FieldBody, f32> {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn FieldBrush + '_>> {
        let Self { lattice, keeps, clip, bands, .. } = self;
        let brushes = brushes(lattice.brushes(cut), *keeps, clip.brushes(cut), bands);
        brushes.map(|brush| Box::new(brush) as Box<dyn FieldBrush>).collect()
    }
}

impl FieldBrush for ClippedBrush<'_, dyn FieldBrush + '_, f32> {
    fn raise(&mut self, band: &mut FieldBand<'_>) {
        let (first, width_px) = (band.first, band.width_px());
        let length = band.count() * width_px;
        let [lattice, clip] = self.bands.each_mut().map(|band| &mut band[..length]);
        self.lattice.raise(&mut FieldBand::empty(first, lattice, width_px));
        self.clip.raise(&mut FieldBand::empty(first, clip, width_px));
        let sign = if self.keeps == Keeps::Inside { 1.0 } else { -1.0 };
        let rows_of_both = lattice.chunks_exact(width_px).zip(clip.chunks_exact(width_px));
        for (row, (lattice, clip)) in band.each_mut().zip(rows_of_both) {
            for (out, (lattice, clip)) in row.iter_mut().zip(lattice.iter().zip(clip)) {
                *out = out.max(lattice.min(sign * clip));
            }
        }
    }
}
