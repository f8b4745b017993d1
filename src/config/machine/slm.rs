//! An SLM machine. `config/machines/sim-slm.toml` explains its keys.

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::{check_link, real_time, yes};
use crate::config::{OutOfRange, within};
use crate::layer::{Mirror, Raster};
use crate::link::LinkSettings;

/// An SLM machine: its line, field, beam and travel.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlmMachine {
    /// For people.
    pub name: String,
    /// Read before, to know which keys there are.
    #[serde(rename = "kind")]
    _kind: IgnoredAny,
    /// Size of the field that the laser reaches, along x and y, micrometres.
    pub field_um: [f64; 2],
    /// Pitch of the grid on which layers are sampled for their contours, micrometres.
    #[serde(default = "thirty")]
    pub grid_um: f64,
    /// Largest part height, micrometres.
    pub build_height_um: f64,
    /// Width of the melted track, micrometres.
    pub beam_diameter_um: f64,
    /// Greatest power of the laser, watts.
    pub max_power_w: f64,
    /// Least and greatest layer height, micrometres: what plate and recoater can do.
    pub layer_height_range_um: [f64; 2],
    /// Time that the recoater takes for a layer, milliseconds.
    #[serde(default = "ten_seconds")]
    pub recoat_ms: u32,
    /// Whether the operator must confirm that plate and bed are ready (`layerctl resume`) before a queued job begins.
    #[serde(default = "yes")]
    pub confirm_plate: bool,
    /// How much faster than real time the device's clock runs, 1 to 1000. Only for simulated devices.
    #[serde(default = "real_time")]
    pub time_scale: f64,
    /// The line.
    pub link: LinkSettings,
}

fn thirty() -> f64 {
    30.0
}

fn ten_seconds() -> u32 {
    10_000
}

impl SlmMachine {
    pub(super) fn check(&self) -> Vec<OutOfRange> {
        let [low_um, high_um] = self.layer_height_range_um;
        // Of 1 m: larger fields have several lasers. So many grid points as a picture may have pixels.
        let most_um = f64::from(Raster::MAX_PX) * self.grid_um;
        [
            within("field_um[0]", self.field_um[0], 1000.0, most_um.min(1e6)),
            within("field_um[1]", self.field_um[1], 1000.0, most_um.min(1e6)),
            within("grid_um", self.grid_um, 1.0, 1000.0),
            within("build_height_um", self.build_height_um, 1000.0, 2_000_000.0),
            within("beam_diameter_um", self.beam_diameter_um, 1.0, 1000.0),
            within("max_power_w", self.max_power_w, 0.1, 10_000.0),
            within("layer_height_range_um[0]", low_um, 1.0, 1000.0),
            within("layer_height_range_um[1]", high_um, low_um.clamp(1.0, 1000.0), 1000.0),
            within("recoat_ms", self.recoat_ms, 0, 600_000),
            within("time_scale", self.time_scale, 1.0, 1000.0),
        ]
        .into_iter()
        .flatten()
        .chain(check_link(&self.link))
        .collect()
    }

    /// The grid on which layers are sampled.
    pub fn raster(&self) -> Raster {
        let [width_px, height_px] = self.field_um.map(|um| (um / self.grid_um).ceil() as u32);
        Raster {
            width_px,
            height_px,
            pixel_um: [self.grid_um; 2],
            build_height_um: self.build_height_um,
            mirror: Mirror::default(),
        }
    }
}
