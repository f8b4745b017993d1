//! One machine: its line, picture and travel.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{ConfigError, OutOfRange, parse, read_text, within};
use crate::layer::{Mirror, Raster};
use crate::link::LinkSettings;

/// A DLP machine, `config/machines/*.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    /// For people.
    pub name: String,
    /// What kind of machine this is.
    pub kind: MachineKind,
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

fn yes() -> bool {
    true
}

fn real_time() -> f64 {
    1.0
}

/// Kinds of machine a configuration can describe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MachineKind {
    /// Resin, a projector or masked panel.
    Dlp,
}

impl Machine {
    /// Reads and checks a machine file.
    ///
    /// # Errors
    /// [`ConfigError`] names file, key, value and the allowed range.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::parse(path, &read_text(path)?)
    }

    /// Parses and checks a machine's text. Errors name `path`; a relative `link.path` is relative to its directory.
    ///
    /// # Errors
    /// [`ConfigError`] names file, key, value and the allowed range.
    pub fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let mut machine = parse(path, text, Self::check)?;
        // A path in a file is relative to the file's directory.
        machine.link.path = path.parent().unwrap_or(Path::new(".")).join(&machine.link.path);
        Ok(machine)
    }

    fn check(&self) -> Vec<OutOfRange> {
        let path = self.link.path.as_os_str().is_empty().then(|| OutOfRange {
            key: "link.path".into(),
            value: "\"\"".into(),
            allowed: "the path of a serial port".into(),
        });
        [
            within("width_px", self.width_px, 16, Raster::MAX_PX),
            within("height_px", self.height_px, 16, Raster::MAX_PX),
            within("pixel_um[0]", self.pixel_um[0], 1.0, 1000.0),
            within("pixel_um[1]", self.pixel_um[1], 1.0, 1000.0),
            within("build_height_um", self.build_height_um, 1000.0, 2_000_000.0),
            within("clear_height_um", self.clear_height_um, 1000.0, 2_000_000.0),
            within("time_scale", self.time_scale, 1.0, 1000.0),
            path,
            within("link.baud", self.link.baud, 9600, 12_000_000),
        ]
        .into_iter()
        .flatten()
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
