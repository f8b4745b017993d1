//! The layers of a part of several materials: one mask for each material. `tests/materials/` compares them with the layers of a `Slicer`.

use std::sync::Arc;

use super::band::Band;
use super::bodies::{self, Bodies};
use super::body::masks::MaskBody;
use super::body::{BodySource, Cut};
use super::{SliceError, SlicePlan};
use crate::buildfile::{BuildFile, Materials, Split};
use crate::layer::{Bitmap, Depth};
use crate::solid::{Effort, InstructionSet};
use crate::stream::MemoryBudget;

/// Computes the layers of a plan as masks, in ascending order. The masks of a layer are the picture that [`Slicer`](super::Slicer) draws of it, and no pixel is lit
/// in two of them. They depend on part and plan alone.
pub struct MaskSlicer {
    plan: SlicePlan,
    material_count: usize,
    next_layer: u32,
    bodies: Bodies<dyn MaskBody>,
}

/// The bodies of a part, and the material of each.
pub struct MaskSources {
    bodies: Vec<(BodySource, u8)>,
    split: Split,
    material_count: usize,
}

impl MaskSources {
    /// Those of a build file. A part without materials has one.
    pub fn of(file: &Arc<BuildFile>) -> Self {
        Self::new(BodySource::with_materials(file), file.header().materials.as_ref())
    }

    /// These bodies, each with its place in the list of materials; that of a joined one has no meaning.
    pub fn new(bodies: Vec<(BodySource, u8)>, materials: Option<&Materials>) -> Self {
        let (split, count) = materials.map_or((Split::default(), 1), |some| (some.split, some.names.len()));
        Self { bodies, split, material_count: count }
    }
}

impl MaskSlicer {
    /// A slicer whose first layer is `first_layer`. Its memory is charged to `budget` now.
    ///
    /// # Errors
    /// As [`Slicer::new`](super::Slicer::new).
    pub fn new(
        sources: MaskSources,
        plan: SlicePlan,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        Self::with_instructions(InstructionSet::detect(), sources, plan, threads, first_layer, budget)
    }

    /// As [`MaskSlicer::new`], with a given instruction set. All sets of [`InstructionSet::available`] give equal bits.
    ///
    /// # Errors
    /// As [`Slicer::new`](super::Slicer::new).
    pub fn with_instructions(
        instructions: InstructionSet,
        sources: MaskSources,
        plan: SlicePlan,
        threads: usize,
        first_layer: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, SliceError> {
        let MaskSources { bodies, split, material_count } = sources;
        let (bodies, materials): (Vec<_>, Vec<_>) = bodies.into_iter().unzip();
        let mut materials = materials.into_iter();
        let body = |source: BodySource| {
            let material = materials.next().unwrap_or(0);
            source.masks(instructions, material, split, &plan, threads, budget)
        };
        let file_bytes = bodies::file_bytes(bodies.iter().flat_map(BodySource::files), threads);
        let bodies = Bodies::new(bodies, file_bytes, threads, budget, body)?;
        Ok(Self { plan, material_count, next_layer: first_layer, bodies })
    }

    /// Memory that a slicer will charge to its budget, bytes. It is known before a chunk is read.
    pub fn memory_bytes(sources: &MaskSources, plan: &SlicePlan, threads: usize) -> u64 {
        let each = sources.bodies.iter().map(|(body, _)| body.masks_memory_bytes(plan, threads));
        let files = bodies::file_bytes(sources.bodies.iter().flat_map(|(body, _)| body.files()), threads);
        each.fold(files, u64::saturating_add)
    }

    /// The pictures that [`MaskSlicer::next_layer`] draws on.
    pub fn dark_masks(&self) -> Vec<Bitmap> {
        let SlicePlan { raster, depth, .. } = &self.plan;
        vec![Bitmap::new(raster.width_px, raster.height_px, *depth); self.material_count]
    }

    /// Draws the masks of the next layer and returns its number; `None` after the last. Overwrites `masks`, which are as [`MaskSlicer::dark_masks`].
    ///
    /// # Errors
    /// As [`Slicer::next_layer`](super::Slicer::next_layer).
    pub fn next_layer(&mut self, masks: &mut [Bitmap]) -> Result<Option<u32>, SliceError> {
        let layer = self.next_layer;
        if layer >= self.plan.layer_count {
            return Ok(None);
        }
        self.draw_plane(self.plan.layer_z_um(layer), [0.0; 2], masks)?;
        self.next_layer += 1;
        Ok(Some(layer))
    }

    /// Draws the plane at `z_um`, with the thresholds of the next layer. As [`Slicer::draw_plane`](super::Slicer::draw_plane).
    pub(super) fn draw_plane(&mut self, z_um: f64, shift_px: [f64; 2], masks: &mut [Bitmap]) -> Result<(), SliceError> {
        let plan = &self.plan;
        let wanted = (plan.raster.width_px, plan.raster.height_px, plan.depth);
        let size = |mask: &Bitmap| (mask.width_px(), mask.height_px(), mask.depth());
        if masks.len() != self.material_count || masks.iter().any(|mask| size(mask) != wanted) {
            return Err(SliceError::WrongBitmap);
        }
        let depth = plan.depth;
        self.bodies.advance(z_um)?;
        self.draw(&Cut { z_um, shift_px, layer: self.next_layer }, depth, masks);
        Ok(())
    }

    /// Draws all bodies band by band. Each free thread takes the next band.
    fn draw(&mut self, cut: &Cut, depth: Depth, masks: &mut [Bitmap]) {
        let Some(rows_per_band) = self.bodies.rows_per_band() else { return };
        let (bodies, workers) = self.bodies.parts();
        let mut threads: Vec<Vec<_>> = (0..workers.count()).map(|_| Vec::new()).collect();
        for body in bodies {
            for (brushes, brush) in threads.iter_mut().zip(body.brushes(cut)) {
                brushes.push(brush);
            }
        }
        let (width_px, stride_bytes) = (masks[0].width_px() as usize, masks[0].stride_bytes());
        let mut pieces: Vec<_> =
            masks.iter_mut().map(|mask| mask.data_mut().chunks_mut(stride_bytes * rows_per_band)).collect();
        let next = || pieces.iter_mut().map(Iterator::next).collect::<Option<Vec<_>>>();
        workers.run(std::iter::from_fn(next).enumerate(), &mut threads, |brushes, (number, pieces)| {
            let band = |bytes| Band::dark(depth, number * rows_per_band, bytes, stride_bytes);
            let mut bands: Vec<_> = pieces.into_iter().map(band).collect();
            for brush in brushes {
                brush.cover(&mut bands);
            }
            bands.into_iter().for_each(|band| band.finish(width_px));
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
