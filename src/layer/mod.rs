//! What geometry makes and devices take: layers of pixels and of scan vectors, and the grid of pixels they are made for.
//!
//! Used by `slice`, which makes layers, by `device::encoding`, which turns them into bytes, and by `layerctl slice`.

mod bitmap;
pub mod export;
mod raster;
mod vectors;

pub use bitmap::{Bitmap, Depth};
/// The parts of scan vectors that host and device share.
pub use layerd_wire::encoding::{HatchFrame, HatchLine, LaserParameters, MarkClass};
pub use raster::{Mirror, Raster};
pub use vectors::{Mark, Run, Vectors, hatch_frame};
