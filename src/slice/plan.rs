//! The plan of a print: from a part, a raster and a layer height to the pixels and planes that are sampled. [`slice`](crate::slice) has
//! an example.

use crate::buildfile::{Header, Placement};
use crate::layer::{Depth, Raster};

/// A part cannot be sliced for a machine.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The raster has no pixels, or too many.
    #[error(
        "a picture of {} × {} pixels of {:?} µm: allowed are 1 to {} pixels along a side, of a pitch greater than 0",
        .0.width_px, .0.height_px, .0.pixel_um, Raster::MAX_PX
    )]
    BadRaster(Raster),
    /// The part does not fit the build volume.
    #[error("{0}")]
    OutsideVolume(String),
    /// The layer height is out of range.
    #[error("a layer height of {0} µm: allowed is 1 to 1000 µm")]
    BadLayerHeight(f64),
    /// There are more layers than can be named.
    #[error(
        "{layers} layers of {layer_height_um} µm: at most {MAX_LAYERS} are possible; choose a greater layer height"
    )]
    TooManyLayers {
        /// Number of layers.
        layers: f64,
        /// Layer height, micrometres.
        layer_height_um: f64,
    },
}

/// Most layers of a part: file names of layers have six digits.
const MAX_LAYERS: u32 = 1_000_000;

/// Everything that the slicer needs besides the primitives. Layer k is sampled at `z0_um + (k + ½)·layer_height_um`.
#[derive(Clone, Debug, PartialEq)]
pub struct SlicePlan {
    /// The raster of the machine.
    pub raster: Raster,
    /// Bits or grey.
    pub depth: Depth,
    /// Centre of the first pixel of the picture in the coordinates of the build file, micrometres.
    pub origin_um: [f64; 2],
    /// Height of the plate in the coordinates of the build file, micrometres: the lowest solid point of the part.
    pub z0_um: f64,
    /// Layer height, micrometres.
    pub layer_height_um: f64,
    /// Number of layers.
    pub layer_count: u32,
}

/// A part may exceed the volume by this much: less than the precision of any machine, more than the rounding errors of placement.
const TOLERANCE_UM: f64 = 1e-3;

impl SlicePlan {
    /// Smallest layer height, micrometres: no mechanism makes smaller steps.
    pub(crate) const MIN_HEIGHT_UM: f64 = 1.0;
    /// Largest layer height, micrometres: no resin cures through more.
    pub(crate) const MAX_HEIGHT_UM: f64 = 1000.0;

    /// Places a part on a raster.
    ///
    /// # Errors
    /// [`PlanError`] if the raster or the layer height is out of range, the bounds of the part leave the build volume (it names axis
    /// and excess), or there would be too many layers.
    pub fn new(header: &Header, raster: Raster, depth: Depth, layer_height_um: f64) -> Result<Self, PlanError> {
        if !raster.is_valid() {
            return Err(PlanError::BadRaster(raster));
        }
        if !(Self::MIN_HEIGHT_UM..=Self::MAX_HEIGHT_UM).contains(&layer_height_um) {
            return Err(PlanError::BadLayerHeight(layer_height_um));
        }
        let low_um = header.bounds.min.map(|x| f64::from(x) * header.quantum_um);
        let high_um = header.bounds.max.map(|x| f64::from(x) * header.quantum_um);
        let area_um = raster.area_um();
        let corner_um = [0, 1].map(|axis| {
            let middle_um = match header.placement {
                Placement::Centred => area_um[axis] / 2.0,
                Placement::At { x_mm, y_mm } => [x_mm, y_mm][axis] * 1000.0,
            };
            (low_um[axis] + high_um[axis]) / 2.0 - middle_um
        });
        let z0_um = header.bottom_um;
        let low_um = [low_um[0], low_um[1], z0_um];
        check_volume(&raster, low_um, high_um, corner_um)?;
        let layers = ((high_um[2] - low_um[2]) / layer_height_um - 1e-9).ceil().max(1.0);
        if layers > f64::from(MAX_LAYERS) {
            return Err(PlanError::TooManyLayers { layers, layer_height_um });
        }
        let mirrored = [raster.mirror.x, raster.mirror.y];
        let origin_um = [0, 1].map(|axis| {
            let half = raster.pixel_um[axis] / 2.0;
            corner_um[axis] + if mirrored[axis] { area_um[axis] - half } else { half }
        });
        Ok(Self { raster, depth, origin_um, z0_um, layer_height_um, layer_count: layers as u32 })
    }

    /// Height of the plane at which a layer is sampled: the middle of the layer, micrometres.
    pub fn layer_z_um(&self, layer: u32) -> f64 {
        self.z0_um + (f64::from(layer) + 0.5) * self.layer_height_um
    }

    /// Distance from one pixel centre to the next along a row, and along a column, micrometres. Negative if mirrored.
    pub fn step_um(&self) -> [f64; 2] {
        let [x, y] = self.raster.pixel_um;
        [if self.raster.mirror.x { -x } else { x }, if self.raster.mirror.y { -y } else { y }]
    }
}

/// Quarter turns, as `--rotate` takes them, after which a part of this size fits the volume.
fn turn_that_fits(size: [f64; 3], volume: [f64; 3]) -> Option<&'static str> {
    // For each, the axes of the part that then lie along x, y and z.
    let turns = [
        ("0,0,90", [1, 0, 2]),
        ("90,0,0", [0, 2, 1]),
        ("0,90,0", [2, 1, 0]),
        ("90,0,90", [2, 0, 1]),
        ("90,90,0", [1, 2, 0]),
    ];
    let fits = |axes: [usize; 3]| (0..3).all(|axis| size[axes[axis]] <= volume[axis] + TOLERANCE_UM);
    turns.into_iter().find_map(|(turn, axes)| fits(axes).then_some(turn))
}

fn check_volume(raster: &Raster, low_um: [f64; 3], high_um: [f64; 3], corner_um: [f64; 2]) -> Result<(), PlanError> {
    let [area_x, area_y] = raster.area_um();
    let volume = [area_x, area_y, raster.build_height_um];
    let size = [0, 1, 2].map(|axis| high_um[axis] - low_um[axis]);
    let outside = |text: String| Err(PlanError::OutsideVolume(text));
    let mut too_long = Vec::new();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let excess = size[axis] - volume[axis];
        // NaN counts as outside.
        if excess <= TOLERANCE_UM {
            continue;
        }
        too_long.push(format!(
            "{:.3} mm along {name}, {:.3} mm more than the build volume's {:.3} mm",
            size[axis] / 1000.0,
            excess / 1000.0,
            volume[axis] / 1000.0
        ));
    }
    if !too_long.is_empty() {
        let remedy = if let Some(turn) = turn_that_fits(size, volume) {
            format!("it fits turned: pack it with `--rotate {turn}`")
        } else {
            let scale = (0..3).map(|k| volume[k] / size[k]).fold(1.0, f64::min);
            match (scale * 1000.0).floor() / 1000.0 {
                0.0 => "it is more than a thousand times too large: is its unit of length right?".to_owned(),
                scale => format!("pack it at most {scale:.3} times as large as now (`--scale`)"),
            }
        };
        return outside(format!("the part measures {}; {remedy}", too_long.join(", and ")));
    }
    for (axis, name) in ["x", "y"].into_iter().enumerate() {
        let below = corner_um[axis] - low_um[axis];
        let above = high_um[axis] - corner_um[axis] - volume[axis];
        if below > TOLERANCE_UM || above > TOLERANCE_UM {
            let (side, excess) = if below > above { ("low", below) } else { ("high", above) };
            return outside(format!(
                "at its position the part leaves the build area by {:.3} mm at the {side} end of {name}; pack it with another \
                 `--at`, or without `--at`, which centres it",
                excess / 1000.0
            ));
        }
    }
    Ok(())
}
