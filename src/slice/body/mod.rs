//! Bodies, from which layers are drawn. Each is cut by a plane that rises through it.
//!
//! A kind of body is a variant of [`BodySource`] and an implementer of [`Body`], [`PixelBody`] and [`FieldBody`]. `slicer` shows how they
//! are used. `source`, `feed` and `buckets` are what the sweeps of all kinds have in common.

mod buckets;
mod clipped;
mod feed;
pub(super) mod fields;
mod lattice;
pub(super) mod masks;
pub(super) mod source;
mod surface;

use std::sync::Arc;

use super::band::{Band, FieldBand};
use super::workers::Workers;
use super::{SliceError, SlicePlan};
use crate::buildfile::{BodyHeader, BuildFile, Clip, Joint, Keeps, Lattice, Patch, Split, Strut, Triangle};
use crate::solid::{Effort, InstructionSet};
use crate::stream::MemoryBudget;
use lattice::joined;
use masks::{MaskBody, OfMaterial};
use source::{ChunkSource, Stored};

/// Source of the primitives of one body.
pub enum BodySource {
    /// Struts and balls.
    Lattice(Box<dyn ChunkSource<Strut>>),
    /// Struts and balls of several materials, which are joined into one solid.
    Joined(Vec<JoinedLattice>),
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

/// The struts of one material of a joined lattice.
pub struct JoinedLattice {
    /// The struts and balls.
    pub lattice: Box<dyn ChunkSource<Strut>>,
    /// Place in the list of materials.
    pub material: u8,
}

impl BodySource {
    /// The bodies of a build file.
    pub fn of(file: &Arc<BuildFile>) -> Vec<Self> {
        Self::drawn_as(file, Lattice::clone).map(|(source, _)| source).collect()
    }

    /// The bodies of a build file, and the material of each; 0 if the file names none.
    pub(super) fn with_materials(file: &Arc<BuildFile>) -> Vec<(Self, u8)> {
        Self::drawn_as(file, Lattice::clone).collect()
    }

    /// The bodies of a build file, each lattice drawn as the exact union of its struts.
    pub(super) fn unions_of(file: &Arc<BuildFile>) -> Vec<Self> {
        // A union reaches less far than a convolution, so the peak of active struts in the file is an upper bound for it, too.
        let drawn = |lattice: &Lattice| Lattice { joint: Joint::Union, ..lattice.clone() };
        Self::drawn_as(file, drawn).map(|(source, _)| source).collect()
    }

    fn drawn_as(file: &Arc<BuildFile>, drawn: impl Fn(&Lattice) -> Lattice) -> impl Iterator<Item = (Self, u8)> {
        let bodies = &file.header().bodies;
        let joined = file.header().joined().unwrap_or(0..0);
        let material = |body: usize| file.header().materials.as_ref().map_or(0, |some| some.of_bodies[body]);
        let stored =
            |body: usize, lattice: &Lattice| Box::new(Stored { file: Arc::clone(file), body, header: drawn(lattice) });
        let mut members = Vec::new();
        let mut sources = Vec::new();
        for (body, header) in bodies.iter().enumerate() {
            let file = Arc::clone(file);
            let source = match header {
                BodyHeader::Lattice(lattice) if joined.contains(&body) => {
                    members.push(JoinedLattice { lattice: stored(body, lattice), material: material(body) });
                    continue;
                }
                BodyHeader::Lattice(lattice) => {
                    let lattice = stored(body, lattice);
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
                BodyHeader::Clip(_) => continue,
            };
            sources.push((source, material(body)));
        }
        let group = (!members.is_empty()).then_some((Self::Joined(members), 0));
        group.into_iter().chain(sources)
    }

    /// The open build files that the body is read from.
    pub(super) fn files(&self) -> Vec<&Arc<BuildFile>> {
        match self {
            Self::Lattice(source) | Self::Clipped { lattice: source, .. } => source.file().into_iter().collect(),
            Self::Joined(lattices) => lattices.iter().filter_map(|one| one.lattice.file()).collect(),
            Self::Surface(source) => source.file().into_iter().collect(),
            Self::Relief(source) => source.file().into_iter().collect(),
        }
    }

    /// As [`BodySource::pixels_memory_bytes`], for [`BodySource::masks`].
    pub(super) fn masks_memory_bytes(&self, plan: &SlicePlan, threads: usize) -> u64 {
        match self {
            Self::Joined(lattices) => joined::masks_memory_bytes(lattices, plan, threads),
            _ => self.pixels_memory_bytes(plan, threads).saturating_add(OfMaterial::memory_bytes(plan, threads)),
        }
    }

    /// As [`BodySource::pixels`], as masks: of its own materials if it is joined, else of the given one.
    ///
    /// # Errors
    /// As [`BodySource::pixels`].
    pub(super) fn masks(
        self,
        instructions: InstructionSet,
        material: u8,
        split: Split,
        plan: &SlicePlan,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Box<dyn MaskBody>, SliceError> {
        match self {
            Self::Joined(lattices) => joined::masks(instructions, lattices, split, plan, threads, budget),
            other => {
                let body = other.pixels(instructions, plan, threads, budget)?;
                Ok(Box::new(OfMaterial::new(body, material.into(), plan, threads, budget)?))
            }
        }
    }

    /// Memory that [`BodySource::pixels`] charges, bytes. It is known before anything is read, and does not include
    /// [`BodySource::file`].
    pub(super) fn pixels_memory_bytes(&self, plan: &SlicePlan, threads: usize) -> u64 {
        match self {
            Self::Lattice(source) => lattice::pixels_memory_bytes(&**source, plan, threads),
            Self::Joined(lattices) => joined::pixels_memory_bytes(lattices, plan, threads),
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
            Self::Joined(lattices) => joined::field_memory_bytes(lattices, plan, threads),
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
            Self::Joined(lattices) => joined::pixels(instructions, lattices, plan, threads, budget),
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
            Self::Joined(lattices) => joined::field(instructions, lattices, plan, threads, budget),
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
    /// The layer that is drawn.
    pub(super) layer: u32,
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
