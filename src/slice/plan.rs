//! From a part, a raster and a layer height to the pixels and planes that will be sampled.

use crate::buildfile::{Header, Placement};
use crate::layer::{Depth, Raster};

/// Why a part cannot be sliced for a machine.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// A picture of no size, or too large.
    #[error(
        "a picture of {} × {} pixels of {:?} µm: allowed are 1 to {} pixels along a side, of a pitch greater than 0",
        .0.width_px, .0.height_px, .0.pixel_um, Raster::MAX_PX
    )]
    BadRaster(Raster),
    /// The part leaves the build volume.
    #[error("{0}")]
    OutsideVolume(String),
    /// A layer height that is no height.
    #[error("a layer height of {0} µm: allowed is 1 to 1000 µm")]
    BadLayerHeight(f64),
    /// More layers than layers have names.
    #[error(
        "{layers} layers of {layer_height_um} µm: at most {MOST_LAYERS} are possible; choose a greater layer height"
    )]
    TooManyLayers {
        /// Layers it would take.
        layers: f64,
        /// Layer height asked for.
        layer_height_um: f64,
    },
}

/// Layers are named with six digits.
const MOST_LAYERS: u32 = 1_000_000;

/// Everything the slicer must know besides the struts: layer k is sampled at `z0_um + (k + ½)·layer_height_um`.
#[derive(Clone, Debug, PartialEq)]
pub struct SlicePlan {
    /// The raster this plan is for.
    pub raster: Raster,
    /// Bits a pixel.
    pub depth: Depth,
    /// Where the centre of the picture's first pixel lies in the build file's coordinates, micrometres.
    pub origin_um: [f64; 2],
    /// The lowest solid point of the part, micrometres: the plate.
    pub z0_um: f64,
    /// Layer height, micrometres.
    pub layer_height_um: f64,
    /// Number of layers.
    pub layer_count: u32,
}

/// Parts may exceed the volume by this much: less than any machine can tell, more than placement rounds.
const TOLERANCE_UM: f64 = 1e-3;

impl SlicePlan {
    /// Least layer height, micrometres: no mechanism steps less.
    pub const LEAST_HEIGHT_UM: f64 = 1.0;
    /// Greatest layer height, micrometres: no resin cures through more.
    pub const MOST_HEIGHT_UM: f64 = 1000.0;

    /// Places a part on a raster.
    ///
    /// # Errors
    /// [`PlanError`] where the raster or the layer height is out of range, the part's bounds leave the build area or height (it
    /// names axis and excess), or there would be too many layers.
    pub fn new(header: &Header, raster: Raster, depth: Depth, layer_height_um: f64) -> Result<Self, PlanError> {
        if !raster.is_valid() {
            return Err(PlanError::BadRaster(raster));
        }
        if !(Self::LEAST_HEIGHT_UM..=Self::MOST_HEIGHT_UM).contains(&layer_height_um) {
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
        if layers > f64::from(MOST_LAYERS) {
            return Err(PlanError::TooManyLayers { layers, layer_height_um });
        }
        let mirrored = [raster.mirror.x, raster.mirror.y];
        let origin_um = [0, 1].map(|axis| {
            let half = raster.pixel_um[axis] / 2.0;
            corner_um[axis] + if mirrored[axis] { area_um[axis] - half } else { half }
        });
        Ok(Self { raster, depth, origin_um, z0_um, layer_height_um, layer_count: layers as u32 })
    }

    /// The plane a layer is sampled at: its middle, micrometres.
    pub fn layer_z_um(&self, layer: u32) -> f64 {
        self.z0_um + (f64::from(layer) + 0.5) * self.layer_height_um
    }

    /// From one pixel centre to the next along a row and down a column, micrometres; negative where mirrored.
    pub fn step_um(&self) -> [f64; 2] {
        let [x, y] = self.raster.pixel_um;
        [if self.raster.mirror.x { -x } else { x }, if self.raster.mirror.y { -y } else { y }]
    }
}

/// The quarter turns, as `--rotate` takes them, after which a part of that size fits the volume.
fn turn_that_fits(size: [f64; 3], volume: [f64; 3]) -> Option<&'static str> {
    // Which of the part's axes lies along x, y and z after each.
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
        // Not a number is outside, too.
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
                0.0 => "it is more than a thousand times too large: was its unit of length meant?".to_owned(),
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
                "where it is placed the part leaves the build area by {:.3} mm at the {side} end of {name}; pack it with \
                 another `--at`, or without: then it is centred",
                excess / 1000.0
            ));
        }
    }
    Ok(())
}
