//! Slicing: what the pixels of each layer of a part are.
//!
//! A [`SlicePlan`] places a part on a machine's raster. A [`Slicer`] moves a plane upwards through the bodies of the part, each read
//! from a [`BodySource`], and draws layer after layer, band by band, on as many threads as it is given. A layer depends on part and
//! plan alone: not on the number of threads, the instruction set, or the layer that the slicer began with.

mod band;
mod body;
mod error;
mod footing;
mod plan;
mod slicer;
mod volume;
mod workers;

pub use body::BodySource;
pub use body::lattice::{ChunkSpan, MemoryStruts, StrutSource};
pub use error::SliceError;
pub use footing::Footing;
pub use plan::{PlanError, SlicePlan};
pub use slicer::Slicer;
pub use volume::{Estimate, Volume};
