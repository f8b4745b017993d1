//! The sweep plane: which struts a layer cuts, and what its pixels are.

mod bitmap;
mod plan;

pub use bitmap::{Bitmap, Depth};
pub use plan::{Mirror, PlanError, Raster, SlicePlan};
