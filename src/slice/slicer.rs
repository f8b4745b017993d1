//! The slicer: a part as a stream of layers. [`slice`](crate::slice) has an example.

use super::band::Band;
use super::bodies::{self, Bodies};
use super::body::{BodySource, Cut, PixelBody};
use super::{SliceError, SlicePlan};
use crate::layer::Bitmap;
use crate::solid::{Effort, InstructionSet};
use crate::stream::MemoryBudget;

/// Computes the layers of a plan, in ascending order.
pub struct Slicer {
    plan: SlicePlan,
    next_layer: u32,
    bodies: Bodies<dyn PixelBody>,
}

impl Slicer {
    /// Most threads: more than any printer's host has cores. Each thread takes the memory of a strip and of a chunk.
    pub const MAX_THREADS: usize = 256;

    /// One thread per core, at most [`Slicer::MAX_THREADS`].
    pub(crate) fn default_threads() -> usize {
        std::thread::available_parallelism().map_or(1, usize::from).min(Self::MAX_THREADS)
    }

    /// A slicer whose first layer is `first_layer`. Its memory is charged to `budget` now.
    ///
    /// # Errors
    /// [`SliceError`] if the memory is not free, the part cannot be sliced or `threads` is out of range.
    pub fn new(
        bodies: Vec<BodySource>,
        plan: SlicePlan,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        Self::with_instructions(InstructionSet::detect(), bodies, plan, threads, first_layer, budget)
    }

    /// As [`Slicer::new`], with a given instruction set. All sets of [`InstructionSet::available`] give equal bits.
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
        let body = |source: BodySource| source.pixels(instructions, &plan, threads, budget);
        let file_bytes = bodies::file_bytes(bodies.iter().flat_map(BodySource::files), threads);
        let bodies = Bodies::new(bodies, file_bytes, threads, budget, body)?;
        Ok(Self { plan, next_layer: first_layer, bodies })
    }

    /// Memory that a slicer will charge to its budget, bytes. It is known before a chunk is read.
    pub fn memory_bytes(bodies: &[BodySource], plan: &SlicePlan, threads: usize) -> u64 {
        let each = bodies.iter().map(|body| body.pixels_memory_bytes(plan, threads));
        let files = bodies::file_bytes(bodies.iter().flat_map(BodySource::files), threads);
        each.fold(files, u64::saturating_add)
    }

    /// Draws the next layer and returns its number; `None` after the last. Overwrites `bitmap`.
    ///
    /// # Errors
    /// [`SliceError`] if the primitives cannot be read or contradict the build file, or if the bitmap does not fit the plan.
    pub fn next_layer(&mut self, bitmap: &mut Bitmap) -> Result<Option<u32>, SliceError> {
        let layer = self.next_layer;
        if layer >= self.plan.layer_count {
            return Ok(None);
        }
        self.draw_plane(self.plan.layer_z_um(layer), [0.0; 2], bitmap)?;
        self.next_layer += 1;
        Ok(Some(layer))
    }

    /// Draws the plane at `z_um`, which must not be lower than the one before. Its pixels are offset from those of the plan by
    /// `shift_px`: at most half a pixel along x and y for bits, 0 for grey.
    pub(super) fn draw_plane(&mut self, z_um: f64, shift_px: [f64; 2], bitmap: &mut Bitmap) -> Result<(), SliceError> {
        let raster = &self.plan.raster;
        let wanted = (raster.width_px, raster.height_px, self.plan.depth);
        if (bitmap.width_px(), bitmap.height_px(), bitmap.depth()) != wanted {
            return Err(SliceError::WrongBitmap);
        }
        self.bodies.advance(z_um)?;
        self.draw_bands(&Cut { z_um, shift_px, layer: self.next_layer }, bitmap);
        Ok(())
    }

    /// Draws all bodies band by band. Each free thread takes the next band.
    fn draw_bands(&mut self, cut: &Cut, bitmap: &mut Bitmap) {
        let (depth, width_px, stride_bytes) = (bitmap.depth(), bitmap.width_px() as usize, bitmap.stride_bytes());
        let Some(rows_per_band) = self.bodies.rows_per_band() else { return };
        let (bodies, workers) = self.bodies.parts();
        let mut threads: Vec<Vec<_>> = (0..workers.count()).map(|_| Vec::new()).collect();
        for body in bodies {
            for (brushes, brush) in threads.iter_mut().zip(body.brushes(cut)) {
                brushes.push(brush);
            }
        }
        let bands = bitmap.data_mut().chunks_mut(stride_bytes * rows_per_band).enumerate();
        workers.run(bands, &mut threads, |brushes, (number, bytes)| {
            let mut band = Band::dark(depth, number * rows_per_band, bytes, stride_bytes);
            for brush in brushes {
                brush.cover(&mut band);
            }
            band.finish(width_px);
        });
    }

    /// Number of primitives within reach of the plane drawn last.
    pub fn active_count(&self) -> usize {
        self.bodies.active_count()
    }

    /// Work since the slicer was made.
    pub fn effort(&self) -> Effort {
        self.bodies.effort()
    }

    /// The plan.
    pub fn plan(&self) -> &SlicePlan {
        &self.plan
    }
}
