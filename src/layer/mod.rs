//! What geometry makes and devices take: one [`Layer`], and the grid of pixels it is made for.
//!
//! Used by `slice`, which draws layers, by `device::encoding`, which turns them into bytes, and by `layerctl slice`.

mod bitmap;
pub mod export;
mod raster;
mod vectors;

pub use bitmap::{Bitmap, Depth};
/// The parts of scan vectors that host and device share.
pub use layerd_wire::encoding::{HatchFrame, HatchLine, LaserParameters, MarkClass};
pub use raster::{Mirror, Raster};
pub use vectors::{Mark, Run, Vectors, hatch_frame};

/// One layer of a part, by what a machine exposes it with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Layer {
    /// Pixels, for a projector or a masked panel.
    Bitmap(Bitmap),
}

impl From<Bitmap> for Layer {
    fn from(bitmap: Bitmap) -> Self {
        Self::Bitmap(bitmap)
    }
}
