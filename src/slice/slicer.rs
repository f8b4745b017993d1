//! A part as a stream of layers.

use super::band::Band;
use super::body::{Body, BodySource, Cut};
use super::workers::Workers;
use super::{SliceError, SlicePlan};
use crate::layer::Bitmap;
use crate::solid::{Effort, InstructionSet};
use crate::stream::MemoryBudget;

/// Computes the layers of a plan, in ascending order.
pub struct Slicer {
    plan: SlicePlan,
    next_layer: u32,
    bodies: Vec<Box<dyn Body>>,
    workers: Workers,
}

impl Slicer {
    /// More than the cores of any host that drives a printer; each takes the memory of a strip and of a chunk.
    pub const MAX_THREADS: usize = 256;

    /// One thread a core, within [`Slicer::MAX_THREADS`].
    pub fn default_threads() -> usize {
        std::thread::available_parallelism().map_or(1, usize::from).min(Self::MAX_THREADS)
    }

    /// A slicer whose first layer will be `first_layer`; what it needs is charged to `budget` now.
    ///
    /// # Errors
    /// [`SliceError`] where the memory is not free, the part cannot be sliced or `threads` is out of range.
    pub fn new(
        bodies: Vec<BodySource>,
        plan: SlicePlan,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        Self::with_instructions(InstructionSet::detect(), bodies, plan, threads, first_layer, budget)
    }

    /// The same on a given instruction set: layers are equal bit for bit on every one of [`InstructionSet::available`].
    ///
    /// # Errors
    /// As [`Slicer::new`].
    pub fn with_instructions(
        instructions: InstructionSet,
        bodies: Vec<BodySource>,
        plan: SlicePlan,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        if !(1..=Self::MAX_THREADS).contains(&threads) {
            return Err(SliceError::BadThreads { threads, max: Self::MAX_THREADS });
        }
        let bodies: Result<_, _> =
            bodies.into_iter().map(|source| source.body(instructions, &plan, threads, budget)).collect();
        Ok(Self { plan, next_layer: first_layer, bodies: bodies?, workers: Workers::new(threads)? })
    }

    /// Bytes a slicer will charge to its budget: known before a chunk is read.
    pub fn memory_bytes(bodies: &[BodySource], plan: &SlicePlan, threads: usize) -> u64 {
        bodies.iter().fold(0, |sum, body| sum.saturating_add(body.memory_bytes(plan, threads)))
    }

    /// Draws the next layer over whatever `bitmap` held and returns its index; `None` after the last.
    ///
    /// # Errors
    /// [`SliceError::Source`] where the struts cannot be read, [`SliceError::WrongBitmap`] where the bitmap does not fit.
    pub fn next_layer(&mut self, bitmap: &mut Bitmap) -> Result<Option<u32>, SliceError> {
        let layer = self.next_layer;
        if layer >= self.plan.layer_count {
            return Ok(None);
        }
        self.draw_plane(self.plan.layer_z_um(layer), [0.0; 2], bitmap)?;
        self.next_layer += 1;
        Ok(Some(layer))
    }

    /// Draws the plane at `z_um`, no lower than any before it. Its pixels lie `shift_px` from the plan's: within half a pixel
    /// along x and y where pixels are bits, else 0.
    pub(super) fn draw_plane(&mut self, z_um: f64, shift_px: [f64; 2], bitmap: &mut Bitmap) -> Result<(), SliceError> {
        let raster = &self.plan.raster;
        let wanted = (raster.width_px, raster.height_px, self.plan.depth);
        if (bitmap.width_px(), bitmap.height_px(), bitmap.depth()) != wanted {
            return Err(SliceError::WrongBitmap);
        }
        for body in &mut self.bodies {
            body.advance(z_um, &self.workers)?;
        }
        self.draw_bands(&Cut { z_um, shift_px }, bitmap);
        Ok(())
    }

    /// Draws all bodies band by band, whichever thread is free.
    fn draw_bands(&mut self, cut: &Cut, bitmap: &mut Bitmap) {
        let (depth, width_px, stride_bytes) = (bitmap.depth(), bitmap.width_px() as usize, bitmap.stride_bytes());
        let Some(rows_per_band) = self.bodies.iter().map(|body| body.rows_per_band()).min() else { return };
        let mut threads: Vec<Vec<_>> = (0..self.workers.count()).map(|_| Vec::new()).collect();
        for body in &mut self.bodies {
            for (brushes, brush) in threads.iter_mut().zip(body.brushes(cut)) {
                brushes.push(brush);
            }
        }
        let bands = bitmap.data_mut().chunks_mut(stride_bytes * rows_per_band).enumerate();
        self.workers.run(bands, &mut threads, |brushes, (number, bytes)| {
            let mut band = Band::dark(depth, number * rows_per_band, bytes, stride_bytes);
            for brush in brushes {
                brush.cover(&mut band);
            }
            band.finish(width_px);
        });
    }

    /// Struts within reach of the layer drawn last.
    pub fn active_struts(&self) -> usize {
        self.bodies.iter().map(|body| body.active_count()).sum()
    }

    /// What drawing has taken since the slicer was made.
    pub fn effort(&self) -> Effort {
        self.bodies.iter().map(|body| body.effort()).sum()
    }

    /// The plan.
    pub fn plan(&self) -> &SlicePlan {
        &self.plan
    }
}
