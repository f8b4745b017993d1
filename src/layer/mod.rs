//! What geometry makes and devices take: one layer as pixels, and the grid of pixels it is made for.
//!
//! Used by `slice`, which draws layers, by `device::encoding`, which turns them into bytes, and by `layerctl slice`.

mod bitmap;
pub mod export;
mod raster;

pub use bitmap::{Bitmap, Depth};
pub use raster::{Mirror, Raster};
