//! Machines, by kind. The file is flat: `kind` says which keys it has. [`config`](super) has an example.

use std::path::Path;

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::kind::{self, Kind};
use super::{ConfigError, OutOfRange, parse, read_text, within};
use crate::layer::{Mirror, Raster};
use crate::link::LinkSettings;

/// A machine, `config/machines/*.toml`. Its methods tell what machines of every kind have.
#[derive(Clone, Debug, PartialEq)]
pub enum Machine {
    /// Resin, and a projector or a masked panel.
    Dlp(DlpMachine),
}

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

fn yes() -> bool {
    true
}

fn real_time() -> f64 {
    1.0
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
        let mut machine = match kind::named_in(path, text)? {
            Some((kind @ Kind::Slm, line)) => return Err(ConfigError::Undriven { path: path.into(), line, kind }),
            None => {
                let message =
                    "missing field `kind`: a machine file says which kind of machine it is for, as in `kind = \"dlp\"`";
                return Err(ConfigError::Parse { path: path.into(), message: message.into() });
            }
            Some((Kind::Dlp, _)) => Self::Dlp(parse(path, text, DlpMachine::check)?),
        };
        // A path in a file is relative to the file's directory.
        let Self::Dlp(DlpMachine { link, .. }) = &mut machine;
        link.path = path.parent().unwrap_or(Path::new(".")).join(&link.path);
        Ok(machine)
    }

    /// Its kind.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Dlp(_) => Kind::Dlp,
        }
    }

    /// Its name, for people.
    pub fn name(&self) -> &str {
        match self {
            Self::Dlp(machine) => &machine.name,
        }
    }

    /// The line to it.
    pub fn link(&self) -> &LinkSettings {
        match self {
            Self::Dlp(machine) => &machine.link,
        }
    }

    /// Whether the operator must confirm that the plate is empty (`layerctl resume`) before a queued job begins.
    pub fn confirm_plate(&self) -> bool {
        match self {
            Self::Dlp(machine) => machine.confirm_plate,
        }
    }

    /// How much faster than real time the device's clock runs, 1 to 1000.
    pub fn time_scale(&self) -> f64 {
        match self {
            Self::Dlp(machine) => machine.time_scale,
        }
    }

    /// Sets [`Machine::time_scale`].
    pub fn set_time_scale(&mut self, time_scale: f64) {
        match self {
            Self::Dlp(machine) => machine.time_scale = time_scale,
        }
    }
}

impl DlpMachine {
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
