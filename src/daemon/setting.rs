//! The daemon's configuration, read and checked before it starts. `start/check.rs` and `start/run.rs` begin with it.

use std::io::ErrorKind;
use std::path::Path;

use anyhow::Context;

use crate::config::{ConfigError, DaemonConfig, Folder, Machine, Recipe, names, read_text};
use crate::pipeline::default_threads;

/// The configuration; it does not change while the daemon runs.
#[derive(Debug)]
pub(crate) struct Setting {
    /// The daemon's settings.
    pub config: DaemonConfig,
    /// The machine.
    pub machine: Machine,
    /// Text of the machine file, kept with each job.
    pub machine_text: String,
    /// The default recipe.
    pub recipe: Recipe,
    /// Its text.
    pub recipe_text: String,
    /// Number of threads that compute layers.
    pub threads: usize,
}

impl Setting {
    /// Reads and checks the daemon's own file.
    ///
    /// # Errors
    /// Names the file, the key, the value and what is allowed.
    pub(super) fn config(place: &Path) -> anyhow::Result<DaemonConfig> {
        DaemonConfig::load(place).map_err(|error| match error {
            ConfigError::Read { .. } => anyhow::anyhow!("{error}; --config names another configuration"),
            error => error.into(),
        })
    }

    /// Reads and checks the files that `config`, read from `place`, names.
    ///
    /// # Errors
    /// All faults found; each names the file, the key, the value and what is allowed.
    pub(super) fn load(place: &Path, config: DaemonConfig) -> Result<Self, Vec<anyhow::Error>> {
        let named = |key: &str| format!("`{key}` in {}", place.display());
        // Read once: what is checked is what is kept with each job.
        let machine = read_text(&config.machine)
            .and_then(|text| Ok((Machine::parse(&config.machine, &text)?, text)))
            .map_err(|error| located(error, Folder::Machines))
            .with_context(|| named("machine"));
        let parse_recipe = |text: &str| match &machine {
            Ok((machine, _)) => Recipe::parse_for(machine, &config.machine, &config.recipe, text),
            // Its own faults are told besides those of the machine.
            Err(_) => Recipe::parse(&config.recipe, text),
        };
        let recipe = read_text(&config.recipe)
            .and_then(|text| Ok((parse_recipe(&text)?, text)))
            .map_err(|error| located(error, Folder::Recipes))
            .with_context(|| named("recipe"));
        let threads = config.threads.unwrap_or_else(default_threads);
        match (machine, recipe) {
            (Ok((machine, machine_text)), Ok((recipe, recipe_text))) => {
                Ok(Self { config, machine, machine_text, recipe, recipe_text, threads })
            }
            (machine, recipe) => Err([machine.err(), recipe.err()].into_iter().flatten().collect()),
        }
    }
}

/// Adds how the path of a file that is not there was resolved. The result is plain text, so that its cause is not repeated.
fn located(error: ConfigError, folder: Folder) -> anyhow::Error {
    let ConfigError::Read { path, source } = &error else { return error.into() };
    if source.kind() != ErrorKind::NotFound {
        return error.into();
    }
    let (list, example) = match folder {
        Folder::Machines => ("layerctl machines", "machines/"),
        Folder::Recipes => ("layerctl recipes", "recipes/"),
    };
    let name =
        path.file_name().map(|name| name.to_string_lossy().into_owned()).filter(|name| names(folder).contains(name));
    let remedy = name.map_or_else(String::new, |name| {
        format!(", not a name: write the path of its file, such as `{example}{name}.toml`; `{list}` shows the files")
    });
    anyhow::anyhow!("{error}; it is a path, counted from the directory of the file that names it{remedy}")
}
