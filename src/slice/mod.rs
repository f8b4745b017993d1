//! The sweep plane: which struts a layer cuts, and what its pixels are.
//!
//! A [`SlicePlan`] places a part on a machine's raster; a [`Slicer`] moves the plane upwards through a [`StrutSource`], keeps
//! the active set and draws layer after layer, band by band, on as many threads as it is given. A layer depends on part and
//! plan alone: not on threads, on which of a processor's instruction sets is used, or on the layer the sweep began with.

mod active;
mod draw;
mod footing;
mod plan;
mod slicer;
mod source;
mod sweep;
mod volume;
mod workers;

pub use footing::Footing;
pub use plan::{PlanError, SlicePlan};
pub use slicer::{SliceError, Slicer};
pub use source::{ChunkSpan, MemoryStruts, StrutSource};
pub use volume::{Estimate, Volume};
