//! From a part, a raster and a layer height to the pixels and planes that will be sampled.

use super::Depth;
use crate::buildfile::Header;

/// Which axes of the picture run against the build file's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mirror {
    /// Columns run towards smaller x.
    pub x: bool,
    /// Rows run towards smaller y.
    pub y: bool,
}

/// The machine's picture and build height, as far as geometry must know them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Raster {
    /// Pixels a row.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixel pitch along x and y, micrometres.
    pub pixel_um: [f64; 2],
    /// Largest part height, micrometres.
    pub build_height_um: f64,
    /// Mirroring.
    pub mirror: Mirror,
}

/// Why a part cannot be sliced for a machine.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The part leaves the build volume.
    #[error("{0}")]
    OutsideVolume(String),
}

/// Everything the slicer must know besides the struts: layer k is sampled at `z0_um + (k + ½)·layer_height_um`.
#[derive(Clone, Debug, PartialEq)]
pub struct SlicePlan {
    /// The raster this plan is for.
    pub raster: Raster,
    /// Bits a pixel.
    pub depth: Depth,
    /// Where the centre of the picture's first pixel lies in the build file's coordinates, micrometres.
    pub origin_um: [f64; 2],
    /// The lowest plane of the part, micrometres: the plate.
    pub z0_um: f64,
    /// Layer height, micrometres.
    pub layer_height_um: f64,
    /// Number of layers.
    pub layer_count: u32,
}

impl SlicePlan {
    /// Places a part on a raster.
    ///
    /// # Errors
    /// [`PlanError::OutsideVolume`] where the part's bounds leave the build area or height: it names axis and excess.
    pub fn new(header: &Header, raster: Raster, depth: Depth, layer_height_um: f64) -> Result<Self, PlanError> {
        let _ = (header, raster, depth, layer_height_um);
        Err(PlanError::OutsideVolume("not yet".into()))
    }
}
