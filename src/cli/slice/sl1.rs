//! `layerctl slice --format sl1`: the pictures as one archive for Prusa's SL1 and SL1S. `tests/slice_formats.rs` compares it with the
//! pictures of `--format png`.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};

use super::{Selection, cannot_write};
use crate::cli;
use crate::config::{Machine, Recipe};
use crate::job::Process;
use crate::layer::export::{Sl1Print, Sl1Writer};
use crate::text::count_text;

/// Writes the archive.
pub(super) fn write(selection: Selection, machine: &Machine, recipe: &Recipe, output: &Path) -> anyhow::Result<()> {
    let is_named = output.extension().is_some_and(|extension| extension == "sl1" || extension == "sl1s");
    ensure!(
        is_named && !output.is_dir(),
        "{}: with --format sl1, -o wants the name of a file that ends with .sl1 or .sl1s",
        output.display()
    );
    let print = describe(&selection, machine, recipe, output)?;
    if let Some(names) = selection.materials() {
        let names = names.to_vec();
        return write_each(selection, &print, &names, output);
    }
    let mut writer = Sl1Writer::create(output, &print).with_context(|| cannot_write(output))?;
    selection.pictures(|_, bitmap| writer.layer(bitmap).with_context(|| cannot_write(output)))?;
    writer.finish().with_context(|| cannot_write(output))?;
    cli::print(&format!("{} in {}", count_text(print.layer_count.into(), "layer"), output.display()))
}

/// Writes an archive for each material: `part.sl1` becomes `part_1.sl1`, `part_2.sl1` and so on.
fn write_each(selection: Selection, print: &Sl1Print, names: &[String], output: &Path) -> anyhow::Result<()> {
    let paths: Vec<_> = (1..=names.len()).map(|number| numbered(output, number)).collect();
    let create = |path: &PathBuf| Sl1Writer::create(path, print).with_context(|| cannot_write(path));
    let mut writers = paths.iter().map(create).collect::<anyhow::Result<Vec<_>>>()?;
    selection.masks(|_, masks| {
        let mut each = writers.iter_mut().zip(masks).zip(&paths);
        each.try_for_each(|((writer, mask), path)| writer.layer(mask).with_context(|| cannot_write(path)))
    })?;
    for (writer, path) in writers.into_iter().zip(&paths) {
        writer.finish().with_context(|| cannot_write(path))?;
    }
    let lines = paths.iter().zip(names).map(|(path, name)| format!("{name} in {}", path.display()));
    let layers = count_text(print.layer_count.into(), "layer");
    cli::print(&format!("{layers}: {}", lines.collect::<Vec<_>>().join(", ")))
}

/// The path of the file for the material of this number, counted from 1.
pub(super) fn numbered(path: &Path, number: usize) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_os_string();
    name.push(format!("_{number}."));
    name.push(path.extension().unwrap_or_default());
    path.with_file_name(name)
}

/// What the archive says of the print: exposures as the recipe has them for the layers that are written.
fn describe(selection: &Selection, machine: &Machine, recipe: &Recipe, output: &Path) -> anyhow::Result<Sl1Print> {
    let (Recipe::Dlp(dlp), Some(process)) = (recipe, Process::new(machine, recipe)) else {
        bail!("an .sl1 holds pictures, and the recipe `{}` is for a laser", recipe.name());
    };
    let range = &selection.range;
    let plan = selection.part.plan();
    let stem = output.file_stem().unwrap_or_default();
    Ok(Sl1Print {
        name: stem.to_string_lossy().into_owned(),
        machine: machine.name().into(),
        recipe: recipe.name().into(),
        raster: plan.raster,
        layer_height_um: plan.layer_height_um,
        exposure_ms: dlp.exposure_ms,
        first_exposure_ms: dlp.layer_exposure_ms(range.start),
        fade_layers: (dlp.bottom_layers + dlp.transition_layers).saturating_sub(range.start),
        layer_count: range.end - range.start,
        print_time_s: process.layers_ms(range.clone()) / 1000.0,
    })
}
