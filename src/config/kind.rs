//! The kind of machine that a file is for. It is read first; then the whole text is read as a file of that kind, so that every
//! error keeps its place in the text. `tests/shipped_config.rs` shows the errors.

use std::fmt;
use std::path::Path;

use serde::Deserialize;

use super::{ConfigError, in_words};

/// Kinds of machine, as `kind` names them in machine and recipe files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A vat of resin, and a projector or a masked panel.
    Dlp,
    /// A bed of powder and a laser.
    Slm,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Dlp => "dlp",
            Self::Slm => "slm",
        })
    }
}

/// The one key of a file that says what the other keys are.
#[derive(Deserialize)]
struct Head {
    kind: Option<Kind>,
}

/// The kind that a text names; `None` if it names none.
pub(super) fn named_in(path: &Path, text: &str) -> Result<Option<Kind>, ConfigError> {
    let head: Head = toml::from_str(text).map_err(|error| {
        let message = in_words(&error.to_string())
            .replace("unknown variant", "unknown kind")
            .replace("wanted string or table", "expected a kind in quotes, as in `kind = \"dlp\"`");
        ConfigError::Parse { path: path.into(), message }
    })?;
    Ok(head.kind)
}
