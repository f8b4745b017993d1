//! Machines, recipes and the daemon's settings, read from TOML. An unknown key or a value out of range is an error that names the
//! file, the key, the value and what is allowed. All values out of range are named at once.
//!
//! Machines and recipes are of a [`Kind`], and each kind has keys of its own:
//!
//! ```
//! use layerd::config::{Recipe, find, Folder};
//!
//! let file = find(Folder::Recipes, "demo")?;
//! let Recipe::Dlp(recipe) = Recipe::parse(&file.path, &file.text)? else { unreachable!() };
//! assert_eq!(recipe.layer_exposure_ms(0), recipe.bottom_exposure_ms);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod daemon;
mod kind;
mod lookup;
mod machine;
mod recipe;

use std::path::{Path, PathBuf};

pub use daemon::{DEFAULT_SOCKET, DEFAULT_SPOOL, DaemonConfig, MAX_THREADS, MIN_BUDGET_BYTES, byte_size};
pub use kind::Kind;
pub use lookup::{ConfigText, FindError, Folder, NotFound, find, names};
pub use machine::{Axes, DlpMachine, Machine, SlmMachine};
pub use recipe::{ClassSettings, DlpRecipe, LaserSettings, Recipe, SlmRecipe, Strategy};

/// A configuration file that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not TOML, or an unknown, missing or mistyped key; the text names line and key.
    #[error("{}: {message}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// What the parser found, with line and column.
        message: String,
    },
    /// A recipe for machines of another kind.
    #[error(
        "{}: this recipe is for machines of kind `{kind}`, but the machine in {} is of kind `{machine_kind}`: choose a recipe for \
         that kind", path.display(), machine.display()
    )]
    OtherKind {
        /// The recipe's file.
        path: PathBuf,
        /// The recipe's kind.
        kind: Kind,
        /// The machine's file.
        machine: PathBuf,
        /// The machine's kind.
        machine_kind: Kind,
    },
    /// Values out of their ranges.
    #[error("{}: {}", path.display(), list(faults))]
    Range {
        /// The file.
        path: PathBuf,
        /// All of them, at least one.
        faults: Vec<OutOfRange>,
    },
}

/// A key whose value is out of range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key} = {value}: allowed is {allowed}")]
pub struct OutOfRange {
    /// The key, with its table.
    key: String,
    /// The value found.
    value: String,
    /// What is allowed.
    allowed: String,
}

fn list(faults: &[OutOfRange]) -> String {
    faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// Checks one value against an inclusive range.
fn within<T: PartialOrd + std::fmt::Display + Copy>(key: &str, value: T, low: T, high: T) -> Option<OutOfRange> {
    if value >= low && value <= high {
        return None;
    }
    Some(OutOfRange { key: key.into(), value: value.to_string(), allowed: format!("{low} to {high}") })
}

/// Largest configuration file: a wrong path must not fill the memory.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// Reads the text of a configuration file.
///
/// # Errors
/// [`ConfigError::Read`]: it is not a regular file, cannot be read, is too long or is not UTF-8.
pub(crate) fn read_text(path: &Path) -> Result<String, ConfigError> {
    let read = || {
        let bytes = crate::disk::read_small(path, MAX_FILE_BYTES)?;
        String::from_utf8(bytes)
            .map_err(|_| std::io::Error::new(std::io::ErrorKind::InvalidData, "it is not UTF-8 text"))
    };
    read().map_err(|source| ConfigError::Read { path: path.into(), source })
}

/// Reads and checks a machine file, and a recipe file for that machine.
///
/// # Errors
/// [`ConfigError`] of the first file that is wrong; [`ConfigError::OtherKind`] if both are right and do not belong together.
pub fn load_pair(machine: &Path, recipe: &Path) -> Result<(Machine, Recipe), ConfigError> {
    let place = machine;
    let machine = Machine::load(place)?;
    let recipe = Recipe::parse_for(&machine, place, recipe, &read_text(recipe)?)?;
    Ok((machine, recipe))
}

fn parse<T: serde::de::DeserializeOwned>(
    path: &Path,
    text: &str,
    check: impl FnOnce(&T) -> Vec<OutOfRange>,
) -> Result<T, ConfigError> {
    let value: T = toml::from_str(text)
        .map_err(|error| ConfigError::Parse { path: path.into(), message: in_words(&error.to_string()) })?;
    let faults = check(&value);
    if faults.is_empty() { Ok(value) } else { Err(ConfigError::Range { path: path.into(), faults }) }
}

/// Replaces the names of Rust types in a parser's message by ranges.
fn in_words(message: &str) -> String {
    message
        .trim_end()
        // `light_pwm` is the only key of that type.
        .replace("expected u8", "expected a whole number from 1 to 255")
        .replace("expected u32", "expected a whole number from 0 to 4294967295")
        .replace("expected usize", "expected a whole number, not negative")
        .replace("expected f64", "expected a number")
}
