//! `layerctl machines | recipes`: which machines and recipes there are. `tests/cli.rs` tests them.

use serde::Serialize;

use crate::config::{ConfigText, DlpMachine, DlpRecipe, Folder, Machine, Recipe, SlmRecipe, find, names};

/// Show the machines or recipes that a name can mean.
#[derive(Debug, clap::Args)]
pub(super) struct ListArgs {
    /// Print one JSON array.
    #[arg(long)]
    json: bool,
}

pub(super) const MACHINES_HELP: &str = "\
Examples:
  layerctl machines                 a line each: its name, what it is, and the file
  layerctl machines --json | jq -r '.[].name'

A name means the file NAME.toml in machines/ below $LAYERD_CONFIG_DIR, /etc/layerd or config, the first that is there, or one that is \
built in. To change one, copy its file under another name.";

pub(super) const RECIPES_HELP: &str = "\
Examples:
  layerctl recipes                  a line each: its name, how it exposes, and the file
  layerctl start part.layerd --recipe fine

A name means the file NAME.toml in recipes/ below $LAYERD_CONFIG_DIR, /etc/layerd or config, the first that is there, or one that is \
built in. To change one, copy its file under another name.";

/// One file.
#[derive(Debug, Serialize)]
struct Entry {
    name: String,
    /// Its main figures; absent where the file is wrong.
    figures: Option<String>,
    /// What is wrong with the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
    file: String,
}

/// Lists machines.
///
/// # Errors
/// Where the output cannot be written.
pub(super) fn machines(args: &ListArgs) -> anyhow::Result<()> {
    list(args, Folder::Machines, |ConfigText { path, text }| {
        Ok(machine_figures(&Machine::parse(path, text).map_err(|error| error.to_string())?))
    })
}

/// Lists recipes.
///
/// # Errors
/// Where the output cannot be written.
pub(super) fn recipes(args: &ListArgs) -> anyhow::Result<()> {
    list(args, Folder::Recipes, |ConfigText { path, text }| {
        Ok(recipe_figures(&Recipe::parse(path, text).map_err(|error| error.to_string())?))
    })
}

fn list(
    args: &ListArgs,
    folder: Folder,
    figures: impl Fn(&ConfigText) -> Result<String, String>,
) -> anyhow::Result<()> {
    let entries: Vec<_> = names(folder).into_iter().map(|name| entry(folder, name, &figures)).collect();
    if args.json {
        return super::print_json(&entries);
    }
    let width = entries.iter().map(|entry| entry.name.chars().count()).max().unwrap_or(0);
    for Entry { name, figures, problem, file } in &entries {
        super::print(&match (figures, problem) {
            (Some(figures), _) => format!("{name:width$}  {figures}; {file}"),
            // The problem names the file.
            (None, problem) => format!("{name:width$}  cannot be used: {}", problem.as_deref().unwrap_or_default()),
        })?;
    }
    Ok(())
}

fn entry(folder: Folder, name: String, figures: &impl Fn(&ConfigText) -> Result<String, String>) -> Entry {
    match find(folder, &name) {
        Ok(text) => {
            let found = figures(&text);
            Entry { name, figures: found.clone().ok(), problem: found.err(), file: text.path.display().to_string() }
        }
        Err(error) => Entry { name, figures: None, problem: Some(error.to_string()), file: String::new() },
    }
}

fn machine_figures(machine: &Machine) -> String {
    match machine {
        Machine::Dlp(machine) => {
            let DlpMachine { name, width_px, height_px, pixel_um: [x, y], build_height_um, .. } = machine;
            let height_mm = build_height_um / 1000.0;
            format!("{name}: {width_px} × {height_px} pixels of {x} × {y} µm, {height_mm} mm high")
        }
        Machine::Slm(machine) => {
            let [x_mm, y_mm] = machine.field_um.map(|um| um / 1000.0);
            let (height_mm, beam_um) = (machine.build_height_um / 1000.0, machine.beam_diameter_um);
            format!("{}: a field of {x_mm} × {y_mm} mm, a beam of {beam_um} µm, {height_mm} mm high", machine.name)
        }
    }
}

fn recipe_figures(recipe: &Recipe) -> String {
    match recipe {
        Recipe::Dlp(recipe) => {
            let DlpRecipe { name, layer_height_um, exposure_ms, bottom_layers, bottom_exposure_ms, .. } = recipe;
            let [exposure_s, bottom_s] = [*exposure_ms, *bottom_exposure_ms].map(|ms| f64::from(ms) / 1000.0);
            format!(
                "{name}: layers of {layer_height_um} µm, {exposure_s} s each, the first {bottom_layers} {bottom_s} s"
            )
        }
        Recipe::Slm(recipe) => {
            let SlmRecipe { name, layer_height_um, laser_power_w, mark_speed_mm_s, hatch_spacing_um, .. } = &**recipe;
            format!(
                "{name}: layers of {layer_height_um} µm, {laser_power_w} W at {mark_speed_mm_s} mm/s, hatches every \
                 {hatch_spacing_um} µm"
            )
        }
    }
}
