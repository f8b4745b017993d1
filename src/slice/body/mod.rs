//! Bodies, from which layers are drawn. Each is cut by a plane that rises through it.
//!
//! A kind of body is a variant of [`BodySource`] and an implementer of [`Body`], [`PixelBody`] and [`FieldBody`]. `slicer` shows how they
//! are used. `source`, `feed` and `buckets` are what the sweeps of all kinds have in common.

mod buckets;
mod clipped;
mod feed;
mod lattice;
pub(super) mod source;
mod surface;

use std::sync::Arc;

use super::band::{Band, FieldBand};
use super::workers::Workers;
use super::{SliceError, SlicePlan};
use crate::buildfile::{Blend, BodyHeader, BuildFile, Clip, Keeps, Lattice, Patch, Strut, Triangle};
use crate::solid::{Effort, InstructionSet};
use crate::stream::MemoryBudget;
use source::{ChunkSource, Stored};

/// Source of the primitives of one body.
pub enum BodySource {
    /// Struts and balls.
    Lattice(Box<dyn ChunkSource<Strut>>),
    /// Triangles.
    Surface(Box<dyn ChunkSource<Triangle>>),
    /// Patches.
    Relief(Box<dyn ChunkSource<Patch>>),
    /// Struts and balls, and triangles that clip them.
    Clipped {
        /// The struts and balls.
        lattice: Box<dyn ChunkSource<Strut>>,
        /// What is left of them.
        keeps: Keeps,
        /// The triangles.
        clip: Box<dyn ChunkSource<Triangle>>,
    },
}

impl BodySource {
    /// The bodies of a build file.
    pub fn of(file: &Arc<BuildFile>) -> Vec<Self> {
        Self::drawn_as(file, Lattice::clone)
    }

    /// The bodies of a build file, each lattice drawn as the exact union of its struts.
    pub(super) fn unions_of(file: &Arc<BuildFile>) -> Vec<Self> {
        // A union reaches less far than a convolution, so the peak of active struts in the file is an upper bound for it, too.
        Self::drawn_as(file, |lattice| Lattice { blend: Blend::Union, ..lattice.clone() })
    }

    fn drawn_as(file: &Arc<BuildFile>, drawn: impl Fn(&Lattice) -> Lattice) -> Vec<Self> {
        let bodies = &file.header().bodies;
        let source = |(body, header): (usize, &BodyHeader)| {
            let file = Arc::clone(file);
            Some(match header {
                BodyHeader::Lattice(lattice) => {
                    let header = drawn(lattice);
                    let lattice = Box::new(Stored { file: Arc::clone(&file), body, header });
                    match bodies.get(body + 1) {
                        Some(BodyHeader::Clip(Clip { keeps, surface, .. })) => {
                            let clip = Box::new(Stored { file, body: body + 1, header: surface.clone() });
                            Self::Clipped { lattice, keeps: *keeps, clip }
                        }
                        _ => Self::Lattice(lattice),
                    }
                }
                BodyHeader::Surface(surface) => Self::Surface(Box::new(Stored { file, body, header: surface.clone() })),
                BodyHeader::Relief(relief) => Self::Relief(Box::new(Stored { file, body, header: relief.clone() })),
                BodyHeader::Clip(_) => return None,
            })
        };
        bodies.iter().enumerate().filter_map(source).collect()
    }

    /// The open build file that the body is read from, if any.
    pub(super) fn file(&self) -> Option<&Arc<BuildFile>> {
        match self {
            Self::Lattice(source) | Self::Clipped { lattice: source, .. } => source.file(),
            Self::Surface(source) => source.file(),
            Self::Relief(source) => source.file(),
        }
    }

    /// Memory that [`BodySource::pixels`] charges, bytes. It is known before anything is read, and does not include
    /// [`BodySource::file`].
    pub(super) fn pixels_memory_bytes(&self, plan: &SlicePlan, threads: usize) -> u64 {
        match self {
            Self::Lattice(source) => lattice::pixels_memory_bytes(&**source, plan, threads),
            Self::Surface(source) => surface::pixels_memory_bytes(&**source, plan, threads),
            Self::Relief(source) => surface::pixels_memory_bytes(&**source, plan, threads),
            Self::Clipped { lattice, clip, .. } => lattice::pixels_memory_bytes(&**lattice, plan, threads)
                .saturating_add(surface::pixels_memory_bytes(&**clip, plan, threads))
                .saturating_add(clipped::pixels_memory_bytes(plan, threads)),
        }
    }

    /// As [`BodySource::pixels_memory_bytes`], for [`BodySource::field`].
    pub(super) fn field_memory_bytes(&self, plan: &SlicePlan, threads: usize) -> u64 {
        match self {
            Self::Lattice(source) => lattice::field_memory_bytes(&**source, plan, threads),
            Self::Surface(source) => surface::field_memory_bytes(&**source, plan, threads),
            Self::Relief(source) => surface::field_memory_bytes(&**source, plan, threads),
            Self::Clipped { lattice, clip, .. } => lattice::field_memory_bytes(&**lattice, plan, threads)
                .saturating_add(surface::field_memory_bytes(&**clip, plan, threads))
                .saturating_add(clipped::field_memory_bytes(plan, threads)),
        }
    }

    /// The body as pixels, to be drawn with `instructions` on `threads` threads. Its memory is charged to `budget`.
    ///
    /// # Errors
    /// [`SliceError`] if the memory is not free or the body cannot be drawn.
    pub(super) fn pixels(
        self,
        instructions: InstructionSet,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Box<dyn PixelBody>, SliceError> {
        match self {
            Self::Lattice(source) => lattice::pixels(instructions, source, plan, threads, budget),
            Self::Surface(source) => surface::pixels(source, plan, threads, budget),
            Self::Relief(source) => surface::pixels(source, plan, threads, budget),
            Self::Clipped { lattice, keeps, clip } => {
                let lattice = lattice::pixels(instructions, lattice, plan, threads, budget)?;
                let clip = surface::pixels(clip, plan, threads, budget)?;
                clipped::pixels(lattice, keeps, clip, plan, threads, budget)
            }
        }
    }

    /// As [`BodySource::pixels`], as a field.
    ///
    /// # Errors
    /// As [`BodySource::pixels`].
    pub(super) fn field(
        self,
        instructions: InstructionSet,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Box<dyn FieldBody>, SliceError> {
        match self {
            Self::Lattice(source) => lattice::field(instructions, source, plan, threads, budget),
            Self::Surface(source) => surface::field(source, plan, threads, budget),
            Self::Relief(source) => surface::field(source, plan, threads, budget),
            Self::Clipped { lattice, keeps, clip } => {
                let lattice = lattice::field(instructions, lattice, plan, threads, budget)?;
                let clip = surface::field(clip, plan, threads, budget)?;
                clipped::field(lattice, keeps, clip, plan, threads, budget)
            }
        }
    }
}

/// A plane through a part, and the position of its pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// Height, micrometres.
    pub(super) z_um: f64,
    /// Offset of its pixels from those of the plan along x and y, pixels.
    pub(super) shift_px: [f64; 2],
}

/// One body of a part. It is called once per layer and once per band, never for single pixels. What is drawn of it is up to
/// [`PixelBody`] and [`FieldBody`].
pub(super) trait Body: Send {
    /// Most rows in a band that its brushes take.
    fn rows_per_band(&self) -> usize;

    /// Moves the plane up to `z_um`, micrometres. It never moves down.
    ///
    /// # Errors
    /// If the primitives cannot be read, or contradict the header or the index.
    fn advance(&mut self, z_um: f64, workers: &Workers) -> Result<(), SliceError>;

    /// Number of primitives within reach of that plane.
    fn active_count(&self) -> usize;

    /// Work since the body was made.
    fn effort(&self) -> Effort;
}

/// A body that is drawn as pixels.
pub(super) trait PixelBody: Body {
    /// Brushes for the plane last given to [`Body::advance`], one for each thread.
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn Brush + '_>>;
}

/// Draws the pixels of one body on one thread.
pub(super) trait Brush: Send {
    /// Merges the body into a band.
    fn cover(&mut self, band: &mut Band<'_>);
}

/// A body that is drawn as a field.
pub(super) trait FieldBody: Body {
    /// Brushes for the plane last given to [`Body::advance`], one for each thread.
    fn brushes(&mut self, cut: &Cut) -> Vec<Box<dyn FieldBrush + '_>>;
}

/// Draws the field of one body on one thread.
pub(super) trait FieldBrush: Send {
    /// Raises a band to the body's excess.
    fn raise(&mut self, band: &mut FieldBand<'_>);
}
