//! What a layer is drawn from: bodies, each cut by the plane that rises through it.

pub(super) mod lattice;

use std::sync::Arc;

use super::band::Band;
use super::workers::Workers;
use super::{SliceError, SlicePlan};
use crate::buildfile::{Blend, BodyHeader, BuildFile, Lattice};
use crate::solid::{Effort, InstructionSet};
use crate::stream::MemoryBudget;
use lattice::{StoredLattice, StrutSource};

/// Where the primitives of one body come from.
pub enum BodySource {
    /// Struts.
    Lattice(Box<dyn StrutSource>),
}

impl BodySource {
    /// The bodies of a build file.
    pub fn of(file: &Arc<BuildFile>) -> Vec<Self> {
        Self::drawn_as(file, Lattice::clone)
    }

    /// The bodies of a build file, each lattice drawn as the exact union of its struts.
    pub(super) fn unions_of(file: &Arc<BuildFile>) -> Vec<Self> {
        // A union reaches less far than a convolution, so the file's bounds on active struts hold for it too.
        Self::drawn_as(file, |lattice| Lattice { blend: Blend::Union, ..lattice.clone() })
    }

    fn drawn_as(file: &Arc<BuildFile>, drawn: impl Fn(&Lattice) -> Lattice) -> Vec<Self> {
        let source = |(body, BodyHeader::Lattice(lattice)): (usize, &BodyHeader)| {
            Self::Lattice(Box::new(StoredLattice { file: Arc::clone(file), body, lattice: drawn(lattice) }))
        };
        file.header().bodies.iter().enumerate().map(source).collect()
    }

    /// Bytes that [`BodySource::body`] charges: known before anything is read.
    pub(super) fn memory_bytes(&self, plan: &SlicePlan, threads: usize) -> u64 {
        let Self::Lattice(source) = self;
        lattice::memory_bytes(&**source, plan, threads)
    }

    /// A body to draw, with `instructions` on `threads` threads; what it needs is charged to `budget`.
    ///
    /// # Errors
    /// [`SliceError`] where the memory is not free or the body cannot be drawn.
    pub(super) fn body(
        self,
        instructions: InstructionSet,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Box<dyn Body>, SliceError> {
        let Self::Lattice(source) = self;
        lattice::body(instructions, source, plan, threads, budget)
    }
}

/// A plane through a part, and where its pixels lie.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// Its height, micrometres.
    pub(super) z_um: f64,
    /// How far its pixels lie from the plan's, pixels along x and y.
    pub(super) shift_px: [f64; 2],
}

/// One body of a part. It is asked once a layer and once a band, never for single pixels.
pub(super) trait Body: Send {
    /// Most rows that [`Brush::cover`] takes at once.
    fn rows_per_band(&self) -> usize;

    /// Moves the plane up; planes ascend.
    ///
    /// # Errors
    /// Where what the body is made of cannot be read, or contradicts what its file promised.
    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError>;

    /// What each thread draws the plane last given to [`Body::advance`] with: as many as the body was made for.
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn Brush + '_>>;

    /// Primitives within reach of that plane.
    fn active_count(&self) -> usize;

    /// What drawing has taken since the body was made.
    fn effort(&self) -> Effort;
}

/// Draws one body for one thread.
pub(super) trait Brush: Send {
    /// Merges the body into a band.
    fn cover(&mut self, band: &mut Band<'_>);
}
