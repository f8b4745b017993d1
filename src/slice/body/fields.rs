//! What of a part is of one material, as fields, for a laser. Where bodies overlap, the last one prevails, so others are cut away by it.
//! `scan/contours.rs` draws them; `tests/materials/regions.rs` compares their regions with the formulas.

use std::sync::Arc;

use super::lattice::joined;
use super::{Body, BodySource, Cut, FieldBody, FieldBrush, JoinedLattice};
use crate::buildfile::BuildFile;
use crate::slice::band::FieldBand;
use crate::slice::workers::Workers;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{Effort, InstructionSet};
use crate::stream::{Charge, MemoryBudget};

/// A body as it takes part in the field of a material, or of the whole.
pub enum FieldSource {
    /// All of it.
    Whole(BodySource),
    /// Of joined convolutions, what is of this material: where its field is the greatest.
    OfMaterial(Vec<JoinedLattice>, u8),
    /// It is of another material: what it covers is cut away from the bodies before it.
    CutAway(BodySource),
}

impl FieldSource {
    /// The bodies of a build file as the field of one of its materials.
    ///
    /// # Errors
    /// [`SliceError::GradedUnion`].
    pub fn of_material(file: &Arc<BuildFile>, material: u8) -> Result<Vec<Self>, SliceError> {
        let mut sources = Vec::new();
        for (source, of) in BodySource::with_materials(file) {
            match source {
                BodySource::Joined(lattices) => Self::add_joined(lattices, material, &mut sources)?,
                other if of == material => sources.push(Self::Whole(other)),
                other => sources.push(Self::CutAway(other)),
            }
        }
        Ok(sources)
    }

    /// Adds what of joined lattices is of a material. They are the first bodies, so there is nothing to cut away.
    fn add_joined(lattices: Vec<JoinedLattice>, material: u8, sources: &mut Vec<Self>) -> Result<(), SliceError> {
        let Some(number) = lattices.iter().position(|one| one.material == material) else { return Ok(()) };
        if lattices[number].lattice.header().joint.support_um().is_some() {
            sources.push(Self::OfMaterial(lattices, material));
            return Ok(());
        }
        if lattices.iter().any(|one| one.lattice.header().is_graded) {
            return Err(SliceError::GradedUnion);
        }
        // Of a union, what no later material covers.
        let mut lattices = lattices.into_iter().skip(number).map(|one| BodySource::Lattice(one.lattice));
        sources.extend(lattices.next().map(Self::Whole));
        sources.extend(lattices.map(Self::CutAway));
        Ok(())
    }

    /// The open build files that it is read from.
    pub(in crate::slice) fn files(&self) -> Vec<&Arc<BuildFile>> {
        match self {
            Self::Whole(source) | Self::CutAway(source) => source.files(),
            Self::OfMaterial(lattices, _) => lattices.iter().filter_map(|one| one.lattice.file()).collect(),
        }
    }

    /// Memory that [`FieldSource::field`] charges, bytes.
    pub(in crate::slice) fn memory_bytes(&self, plan: &SlicePlan, threads: usize) -> u64 {
        match self {
            Self::Whole(source) => source.field_memory_bytes(plan, threads),
            Self::OfMaterial(lattices, _) => joined::field_memory_bytes(lattices, plan, threads),
            Self::CutAway(source) => source.field_memory_bytes(plan, threads).saturating_add(band_bytes(plan, threads)),
        }
    }

    /// The body as a field. As [`BodySource::field`].
    ///
    /// # Errors
    /// As [`BodySource::field`].
    pub(in crate::slice) fn field(
        self,
        instructions: InstructionSet,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Box<dyn FieldBody>, SliceError> {
        Ok(match self {
            Self::Whole(source) => source.field(instructions, plan, threads, budget)?,
            Self::OfMaterial(lattices, material) => {
                joined::field_of(instructions, lattices, material, plan, threads, budget)?
            }
            Self::CutAway(source) => {
                let charge = budget.charge("the bands of what is cut away", band_bytes(plan, threads))?;
                let bands = vec![vec![0.0; band_length(plan)]; threads];
                let body = source.field(instructions, plan, threads, budget)?;
                Box::new(CutAway { body, bands, _charge: charge })
            }
        })
    }
}

/// Rows of a band of what is cut away: as many as contours have at most.
const ROWS_PER_BAND: usize = 64;

fn band_length(plan: &SlicePlan) -> usize {
    plan.raster.width_px as usize * ROWS_PER_BAND
}

fn band_bytes(plan: &SlicePlan, threads: usize) -> u64 {
    ((band_length(plan) * size_of::<f32>()) as u64).saturating_mul(threads as u64)
}

/// A body that lowers what those before it have drawn.
struct CutAway {
    body: Box<dyn FieldBody>,
    /// A band for each thread.
    bands: Vec<Vec<f32>>,
    _charge: Charge,
}

impl Body for CutAway {
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

impl FieldBody for CutAway {
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn FieldBrush + '_>> {
        let brushes = self.body.brushes(cut).into_iter().zip(&mut self.bands);
        brushes.map(|(brush, band)| Box::new(CutAwayBrush { brush, band }) as Box<dyn FieldBrush>).collect()
    }
}

struct CutAwayBrush<'a> {
    brush: Box<dyn FieldBrush + 'a>,
    band: &'a mut [f32],
}

impl FieldBrush for CutAwayBrush<'_> {
    fn raise(&mut self, band: &mut FieldBand<'_>) {
        let (first, width_px) = (band.first, band.width_px());
        let own = &mut self.band[..band.count() * width_px];
        self.brush.raise(&mut FieldBand::empty(first, own, width_px));
        for (row, own) in band.each_mut().zip(own.chunks_exact(width_px)) {
            row.iter_mut().zip(own).for_each(|(excess, own)| *excess = excess.min(-own));
        }
    }
}
