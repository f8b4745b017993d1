//! Machines, by kind. The file is flat: `kind` says which keys it has. [`config`](super) has an example.

mod dlp;
mod slm;

use std::path::Path;

use super::kind::{self, Kind};
use super::{ConfigError, OutOfRange, parse, read_text, within};
use crate::layer::Raster;
use crate::link::LinkSettings;
use crate::link::grbl::GrblMachine;
pub use dlp::DlpMachine;
pub use slm::{Axes, SlmMachine};

/// A machine, `config/machines/*.toml`. Its methods tell what machines of every kind have.
#[derive(Clone, Debug, PartialEq)]
pub enum Machine {
    /// Resin, and a projector or a masked panel.
    Dlp(DlpMachine),
    /// Powder, and a laser.
    Slm(SlmMachine),
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
            None => {
                let message =
                    "missing field `kind`: a machine file says which kind of machine it is for, as in `kind = \"dlp\"`";
                return Err(ConfigError::Parse { path: path.into(), message: message.into() });
            }
            Some(Kind::Dlp) => Self::Dlp(parse(path, text, DlpMachine::check)?),
            Some(Kind::Slm) => Self::Slm(parse(path, text, SlmMachine::check)?),
        };
        // A path in a file is relative to the file's directory.
        let (Self::Dlp(DlpMachine { link, .. }) | Self::Slm(SlmMachine { link, .. })) = &mut machine;
        link.path = path.parent().unwrap_or(Path::new(".")).join(&link.path);
        Ok(machine)
    }

    /// Its kind.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Dlp(_) => Kind::Dlp,
            Self::Slm(_) => Kind::Slm,
        }
    }

    /// The pixels of its pictures, or the grid on which its layers are sampled.
    pub fn raster(&self) -> Raster {
        match self {
            Self::Dlp(machine) => machine.raster(),
            Self::Slm(machine) => machine.raster(),
        }
    }

    /// Height at which the plate is clear of what would harm the part, micrometres: of the resin in a vat. A bed of powder harms
    /// nothing.
    pub fn clear_height_um(&self) -> f64 {
        match self {
            Self::Dlp(machine) => machine.clear_height_um,
            Self::Slm(_) => 0.0,
        }
    }

    /// Its name, for people.
    pub fn name(&self) -> &str {
        match self {
            Self::Dlp(machine) => &machine.name,
            Self::Slm(machine) => &machine.name,
        }
    }

    /// The line to it.
    pub fn link(&self) -> &LinkSettings {
        match self {
            Self::Dlp(machine) => &machine.link,
            Self::Slm(machine) => &machine.link,
        }
    }

    /// The machine as a grbl controller drives it; `None` if its device speaks the framed protocol.
    pub fn grbl(&self) -> Option<GrblMachine> {
        match self {
            Self::Dlp(_) => None,
            Self::Slm(machine) => machine.grbl(),
        }
    }

    /// Whether the operator must confirm that the plate is empty (`layerctl resume`) before a queued job begins.
    pub fn confirm_plate(&self) -> bool {
        match self {
            Self::Dlp(machine) => machine.confirm_plate,
            Self::Slm(machine) => machine.confirm_plate,
        }
    }

    /// How much faster than real time the device's clock runs, 1 to 1000.
    pub fn time_scale(&self) -> f64 {
        match self {
            Self::Dlp(machine) => machine.time_scale,
            Self::Slm(machine) => machine.time_scale,
        }
    }

    /// Sets [`Machine::time_scale`].
    pub fn set_time_scale(&mut self, time_scale: f64) {
        match self {
            Self::Dlp(machine) => machine.time_scale = time_scale,
            Self::Slm(machine) => machine.time_scale = time_scale,
        }
    }
}

/// What is wrong with a line's settings.
fn check_link(link: &LinkSettings) -> impl Iterator<Item = OutOfRange> {
    let path = link.path.as_os_str().is_empty().then(|| OutOfRange {
        key: "link.path".into(),
        value: "\"\"".into(),
        allowed: "the path of a serial port".into(),
    });
    path.into_iter().chain(within("link.baud", link.baud, 9600, 12_000_000))
}
