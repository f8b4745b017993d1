//! Recipes, by kind of machine. The file is flat: `kind` says which keys it has. [`config`](super) has an example.

mod dlp;
mod slm;

use std::path::Path;

use super::kind::{self, Kind};
use super::{ConfigError, Machine, parse, read_text};
pub use dlp::DlpRecipe;
pub use slm::{ClassSettings, LaserSettings, SlmRecipe, Strategy};

/// A recipe, `config/recipes/*.toml`. Its methods tell what recipes of every kind have.
#[derive(Clone, Debug, PartialEq)]
pub enum Recipe {
    /// For a DLP machine.
    Dlp(DlpRecipe),
    /// For an SLM machine.
    Slm(Box<SlmRecipe>),
}

impl Recipe {
    /// Reads and checks a recipe file.
    ///
    /// # Errors
    /// [`ConfigError`] names file, key, value and the allowed range.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::parse(path, &read_text(path)?)
    }

    /// Parses and checks a recipe's text. Errors name `path`.
    ///
    /// # Errors
    /// [`ConfigError`] names file, key, value and the allowed range.
    pub fn parse(path: &Path, text: &str) -> Result<Self, ConfigError> {
        match kind::named_in(path, text)? {
            Some(Kind::Slm) => Ok(Self::Slm(Box::new(parse(path, text, SlmRecipe::check)?))),
            Some(Kind::Dlp) | None => Ok(Self::Dlp(parse(path, text, DlpRecipe::check)?)),
        }
    }

    /// The same of a recipe that is to be used on `machine`, which was read from the file `place`.
    ///
    /// # Errors
    /// [`ConfigError::OtherKind`] names both files if the recipe is for machines of another kind, [`ConfigError::Range`] what is beyond
    /// the machine's limits; else as [`Recipe::parse`].
    pub fn parse_for(machine: &Machine, place: &Path, path: &Path, text: &str) -> Result<Self, ConfigError> {
        let kind = kind::named_in(path, text)?.unwrap_or(Kind::Dlp);
        if kind != machine.kind() {
            let machine_kind = machine.kind();
            return Err(ConfigError::OtherKind { path: path.into(), kind, machine: place.into(), machine_kind });
        }
        let recipe = Self::parse(path, text)?;
        if let (Machine::Slm(machine), Self::Slm(recipe)) = (machine, &recipe) {
            let faults = recipe.check_for(machine);
            if !faults.is_empty() {
                return Err(ConfigError::Range { path: path.into(), faults });
            }
        }
        Ok(recipe)
    }

    /// The kind of machine that it is for.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Dlp(_) => Kind::Dlp,
            Self::Slm(_) => Kind::Slm,
        }
    }

    /// Its name, for people.
    pub fn name(&self) -> &str {
        match self {
            Self::Dlp(recipe) => &recipe.name,
            Self::Slm(recipe) => &recipe.name,
        }
    }

    /// Commanded light of a layer, milliseconds; `None` if it depends on what is in the layer.
    pub fn layer_exposure_ms(&self, layer: u32) -> Option<u32> {
        match self {
            Self::Dlp(recipe) => Some(recipe.layer_exposure_ms(layer)),
            Self::Slm(_) => None,
        }
    }

    /// Layer height, micrometres.
    pub fn layer_height_um(&self) -> f64 {
        match self {
            Self::Dlp(recipe) => recipe.layer_height_um,
            Self::Slm(recipe) => recipe.layer_height_um,
        }
    }
}
