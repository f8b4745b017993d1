//! A DLP machine. `config/machines/sim-dlp.toml` explains its keys.

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::{check_link, real_time, yes};
use crate::config::{OutOfRange, within};
use crate::layer::{Mirror, Raster};
use crate::link::{LinkSettings, Protocol};

/// A DLP machine: its line, picture and travel.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DlpMachine {
    /// For people.
    pub name: String,
    /// Read before, to know which keys there are.
    #[serde(rename = "kind")]
    _kind: IgnoredAny,
    /// Pixels a row.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixel pitch along x and y, micrometres.
    pub pixel_um: [f64; 2],
    /// Largest part height, micrometres.
    pub build_height_um: f64,
    /// Height at which the plate is clear of the resin, micrometres above the bottom of the vat. Pause, stop and abort lift the plate
    /// at least this high.
    pub clear_height_um: f64,
    /// Whether the operator must confirm that the plate is empty (`layerctl resume`) before a queued job begins. Safe to turn off only
    /// for a machine that changes plates by itself, or has none.
    #[serde(default = "yes")]
    pub confirm_plate: bool,
    /// How much faster than real time the device's clock runs, 1 to 1000. Only for simulated devices. The host divides the least
    /// times of exposures and moves by it.
    #[serde(default = "real_time")]
    pub time_scale: f64,
    /// Which picture axes run against those of the build file.
    #[serde(default)]
    pub mirror: Mirror,
    /// The line.
    pub link: LinkSettings,
}

impl DlpMachine {
    pub(super) fn check(&self) -> Vec<OutOfRange> {
        [
            within("width_px", self.width_px, 16, Raster::MAX_PX),
            within("height_px", self.height_px, 16, Raster::MAX_PX),
            within("pixel_um[0]", self.pixel_um[0], 1.0, 1000.0),
            within("pixel_um[1]", self.pixel_um[1], 1.0, 1000.0),
            within("build_height_um", self.build_height_um, 1000.0, 2_000_000.0),
            within("clear_height_um", self.clear_height_um, 1000.0, 2_000_000.0),
            within("time_scale", self.time_scale, 1.0, 1000.0),
        ]
        .into_iter()
        .flatten()
        .chain(check_link(&self.link))
        .chain((self.link.protocol == Protocol::Grbl).then(|| OutOfRange {
            key: "link.protocol".into(),
            value: "\"grbl\"".into(),
            allowed: "\"layerd\": a grbl controller drives a laser (kind = \"slm\")".into(),
        }))
        .collect()
    }

    /// The raster of this machine, for the slicer.
    pub fn raster(&self) -> Raster {
        Raster {
            width_px: self.width_px,
            height_px: self.height_px,
            pixel_um: self.pixel_um,
            build_height_um: self.build_height_um,
            mirror: self.mirror,
        }
    }
}
