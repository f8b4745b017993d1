//! The sweep plane: which struts a layer cuts, and what its pixels are.

mod bitmap;
mod plan;
mod png;

pub use bitmap::{Bitmap, Depth};
pub use plan::{Mirror, PlanError, Raster, SlicePlan};
pub use png::write_png;
