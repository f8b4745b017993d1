//! The sweep plane: which struts a layer cuts, and what its pixels are.
//!
//! A [`SlicePlan`] places a part on a machine's raster; a [`Slicer`] moves the plane upwards through a [`StrutSource`], keeps
//! the active set and draws layer after layer, band by band, on as many threads as it is given. A layer depends on part and
//! plan alone: not on threads, on which of a processor's instruction sets is used, or on the layer the sweep began with.

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
