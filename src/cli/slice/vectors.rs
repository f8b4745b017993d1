//! `layerctl slice` for machines with a laser: layers as scan vectors. `tests/slice_vectors.rs` reads what it writes.

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};

use super::sl1::numbered;
use super::{Format, Selection, cannot_write};
use crate::cli;
use crate::config::{SlmMachine, SlmRecipe};
use crate::layer::Vectors;
use crate::layer::export::{CliWriter, OvfWriter, write_svg};
use crate::pipeline::Scan;
use crate::slice::SlicePlan;
use crate::slice::scan::ScanCounts;
use crate::text::count_text;

/// Writes the layers of a part for a machine with a laser.
pub(super) fn write(
    selection: &Selection,
    format: Format,
    machine: &SlmMachine,
    recipe: &SlmRecipe,
    output: &Path,
) -> anyhow::Result<()> {
    let names = selection.materials().map(<[String]>::to_vec);
    let Some(names) = names else { return write_one(selection, None, format, machine, recipe, output) };
    for (number, name) in (1..).zip(names) {
        cli::print(&format!("material {number}, {name}:"))?;
        // There are at most eight.
        write_one(selection, Some(number), format, machine, recipe, output)?;
    }
    Ok(())
}

/// Writes the layers of a material, by its number from 1 on, or those of the whole part.
fn write_one(
    selection: &Selection,
    material: Option<u8>,
    format: Format,
    machine: &SlmMachine,
    recipe: &SlmRecipe,
    output: &Path,
) -> anyhow::Result<()> {
    let Selection { part, range, threads } = selection;
    let (plan, range) = (part.plan().clone(), range.clone());
    let scan = Scan::of(machine, recipe);
    let mut writer = Writer::create(format, output, material, &range, machine, &scan)?;
    let of_material = material.map(|number| number - 1);
    let mut scanned = part.scanned(of_material, *threads, range.start)?.context("the layers are pictures")?;
    let layer_count = u64::from(range.end - range.start);
    let bar = cli::progress_bar("{bar:40} {pos}/{len} layers, {eta} left");
    bar.set_length(layer_count);
    let (mut counts, mut vectors) = (ScanCounts::default(), 0);
    for _ in range {
        let Some(layer) = scanned.next_layer()? else { bail!("the layers ended too early") };
        writer.layer(layer.layer, &plan, layer.vectors).with_context(|| cannot_write(output))?;
        counts += layer.counts;
        vectors += layer.vectors.mark_count();
        bar.inc(1);
    }
    writer.finish().with_context(|| cannot_write(output))?;
    bar.finish_and_clear();
    cli::print(&summary(layer_count, vectors, &counts, output))
}

/// The files of a format.
enum Writer {
    Svg { directory: PathBuf, material: Option<u8>, field_um: [u32; 2], beam_um: f64 },
    Cli(CliWriter),
    Ovf(Box<OvfWriter>),
}

impl Writer {
    fn create(
        format: Format,
        output: &Path,
        material: Option<u8>,
        range: &Range<u32>,
        machine: &SlmMachine,
        scan: &Scan,
    ) -> anyhow::Result<Self> {
        let is_one_file = matches!(format, Format::Cli | Format::Ovf);
        ensure!(
            !(is_one_file && output.is_dir()),
            "{} is a directory; --format {format} writes one file: name it with -o",
            output.display()
        );
        let file = material.map_or_else(|| output.to_owned(), |number| numbered(output, number.into()));
        let name = output.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(match format {
            Format::Svg => {
                ensure!(!output.is_file(), "{} is a file; -o wants a directory for the pictures", output.display());
                std::fs::create_dir_all(output)
                    .with_context(|| format!("cannot make the directory {}", output.display()))?;
                let beam_um = machine.beam_diameter_um;
                Self::Svg { directory: output.to_owned(), material, field_um: scan.field_um, beam_um }
            }
            Format::Cli => {
                let writer = CliWriter::create(&file, &name, range.end - range.start);
                Self::Cli(writer.with_context(|| cannot_write(&file))?)
            }
            Format::Ovf => {
                let writer = OvfWriter::create(&file, &name, &scan.lasers);
                Self::Ovf(Box::new(writer.with_context(|| cannot_write(&file))?))
            }
            Format::Png | Format::Sl1 => bail!(
                "--format {format} is for machines with pixels; machine `{}` marks vectors: choose svg to look at them, cli or ovf",
                machine.name
            ),
        })
    }

    fn layer(&mut self, layer: u32, plan: &SlicePlan, vectors: &Vectors) -> std::io::Result<()> {
        let top_um = f64::from(layer + 1) * plan.layer_height_um;
        match self {
            Self::Svg { directory, material, field_um, beam_um } => {
                let of_material = material.map(|number| format!("_material_{number}")).unwrap_or_default();
                let path = directory.join(format!("layer_{layer:06}{of_material}.svg"));
                write_svg(&path, vectors, *field_um, *beam_um)
            }
            Self::Cli(writer) => writer.layer(top_um, vectors),
            Self::Ovf(writer) => writer.layer(top_um, vectors),
        }
    }

    fn finish(self) -> std::io::Result<()> {
        match self {
            Self::Svg { .. } => Ok(()),
            Self::Cli(writer) => writer.finish(),
            Self::Ovf(writer) => writer.finish(),
        }
    }
}

fn summary(layers: u64, vectors: u64, counts: &ScanCounts, output: &Path) -> String {
    let metres = |um: f64| um / 1e6;
    let mut lines = vec![
        format!("{} in {}", count_text(layers, "layer"), output.display()),
        format!(
            "vectors         {vectors}, {:.2} m of marks and {:.2} m of jumps ({:.2} m as the regions were found)",
            metres(counts.mark_um),
            metres(counts.jump_um),
            metres(counts.unordered_jump_um)
        ),
        format!(
            "narrow parts    {} as centre lines, {} as points, {} as contours only",
            counts.centre_lines, counts.points, counts.contours_only
        ),
        format!("short hatches   {} merged, {} left out", counts.merged_hatches, counts.dropped_hatches),
    ];
    if counts.unmarked > 0 {
        lines.push(format!(
            "note            {} without a mark: narrower than the laser can make, or than the recipe allows",
            count_text(counts.unmarked, "region")
        ));
    }
    lines.join("\n")
}
