//! `layerctl slice`: writes the layers that a print would send, in one of several formats. `tests/slice_formats.rs` reads them.

mod pictures;
mod sl1;
mod vectors;

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{bail, ensure};
use clap::builder::RangedU64ValueParser;

use crate::config::{Machine, Recipe};
use crate::layer::{Bitmap, Depth};
use crate::pipeline::{Placed, Resolution};
use crate::slice::{SlicePlan, Slicer};
use crate::text::count_text;

/// Write the layers of a part as files, the same that a print sends.
#[derive(Debug, clap::Args)]
#[command(after_help = super::with_names("\
Examples:
  layerctl slice lattice.layerd --machine lcd-4k-35um --recipe fine -o layers
  layerctl slice lattice.layerd -m sim-dlp --layers 100..110 --antialias -o some    layers 100 to 109
  layerctl slice lattice.layerd -m sl1s.toml --format sl1 -o lattice.sl1s           for a Prusa SL1S or UVtools
  layerctl slice lattice.layerd -m sim-slm -r slm-demo -o vectors                   scan vectors, to look at
  layerctl slice lattice.layerd -m sim-slm -r slm-demo --format cli -o lattice.cli

With png, manifest.json says where each picture lies in the build file's coordinates: `origin_mm` is the centre of the first pixel. `z_mm` is \
the middle of a layer, above the part's lowest point. `source_digest` is that of the file that was packed. A grey value is about the \
share of the pixel that is inside the part.

With sl1, the archive has the recipe's exposures, and an exposure that falls from the first layer on; the printer moves as its own \
settings say. Its printer is a Prusa SL1 (1440 × 2560 pixels) or SL1S (1620 × 2560) if the machine has the size of that panel, \
else one of the machine's name. A part of several materials becomes an archive for each: lattice_1.sl1, lattice_2.sl1."))]
pub struct SliceArgs {
    /// Build file (.layerd)
    pub file: PathBuf,
    /// Machine: a name, or the path of a TOML file
    #[arg(long, short, value_name = "NAME|PATH")]
    pub machine: String,
    /// Recipe: a name, or the path of a TOML file; gives layer height and antialiasing
    #[arg(long, short, value_name = "NAME|PATH", default_value = "default")]
    pub recipe: String,
    /// Layer height, 1 to 1000 micrometres, instead of the recipe's
    #[arg(long, value_name = "UM", value_parser = parse_layer_height)]
    pub layer_height: Option<f64>,
    /// Layers from A up to but not including B, counted from 0: 100..200, ..10 or 2990..; all by default
    #[arg(long, value_name = "A..B", value_parser = parse_layers, allow_hyphen_values = true)]
    pub layers: Option<LayerRange>,
    /// 8-bit grey edges, whatever the recipe says
    #[arg(long)]
    pub antialias: bool,
    /// Threads that compute; one for each core by default
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..=Slicer::MAX_THREADS as u64))]
    pub threads: Option<usize>,
    /// What to write; by default png for machines with pixels, svg for machines with a laser
    #[arg(long, value_enum)]
    pub format: Option<Format>,
    /// For png a directory for manifest.json and layer_000000.png, layer_000001.png, … (8 bits a pixel: 0 and 255, or grey; in colour, and one more
    /// for each material, if there are several), made if missing; for svg a directory for layer_000000.svg, …; for sl1, cli and ovf a file
    #[arg(long, short)]
    pub output: PathBuf,
}

/// What `layerctl slice` writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// A PNG picture a layer.
    Png,
    /// One archive of PNG pictures, for Prusa's SL1 and SL1S, PrusaSlicer and UVtools.
    Sl1,
    /// A drawing a layer of the scan vectors.
    Svg,
    /// One file of scan vectors: Common Layer Interface, binary.
    Cli,
    /// One file of scan vectors: OpenVectorFormat.
    Ovf,
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Png => "png",
            Self::Sl1 => "sl1",
            Self::Svg => "svg",
            Self::Cli => "cli",
            Self::Ovf => "ovf",
        })
    }
}

fn parse_layer_height(text: &str) -> Result<f64, String> {
    let height =
        text.parse().ok().filter(|height| (SlicePlan::MIN_HEIGHT_UM..=SlicePlan::MAX_HEIGHT_UM).contains(height));
    height.ok_or_else(|| format!("write micrometres from {} to {}", SlicePlan::MIN_HEIGHT_UM, SlicePlan::MAX_HEIGHT_UM))
}

/// A range of layers; without an end, to the last layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LayerRange {
    first: u32,
    end: Option<u32>,
}

fn parse_layers(text: &str) -> Result<LayerRange, String> {
    let wrong = || format!("`{text}` is not a range of layers; write for example 100..200, ..10 or 2990..");
    let (first, end) = text.split_once("..").ok_or_else(wrong)?;
    let number = |text: &str| text.parse::<u32>().map_err(|_| wrong());
    let first = if first.is_empty() { 0 } else { number(first)? };
    let end = if end.is_empty() { None } else { Some(number(end)?) };
    if end.is_some_and(|end| end <= first) {
        return Err(format!("`{text}` holds no layer: the end must be greater than the beginning"));
    }
    Ok(LayerRange { first, end })
}

/// Runs the command.
///
/// # Errors
/// A file or value that cannot be used. Pictures already written stay; none is left incomplete.
pub fn run(args: SliceArgs) -> anyhow::Result<()> {
    let SliceArgs { file, machine, recipe, layer_height, layers, antialias, threads, format, output } = args;
    let (machine, recipe) = super::find_pair(&machine, &recipe)?;
    let mut resolution = Resolution::of(&machine, &recipe);
    if antialias {
        resolution.depth = Depth::Grey;
    }
    if let Some(layer_height_um) = layer_height {
        resolution.layer_height_um = layer_height_um;
    }
    let part = Placed::open(&file, &resolution)?;
    let range = layers_within(layers, part.plan().layer_count)?;
    let threads = threads.unwrap_or_else(Slicer::default_threads);
    let selection = Selection { part, range, threads };
    if let (Machine::Slm(machine), Recipe::Slm(recipe)) = (&machine, &recipe) {
        ensure!(!antialias, "--antialias is for pictures; machine `{}` marks vectors", machine.name);
        return vectors::write(&selection, format.unwrap_or(Format::Svg), machine, recipe, &output);
    }
    match format.unwrap_or(Format::Png) {
        Format::Png => pictures::write(selection, &output),
        Format::Sl1 => sl1::write(selection, &machine, &recipe, &output),
        format @ (Format::Svg | Format::Cli | Format::Ovf) => {
            bail!("--format {format} is for machines with a laser; machine `{}` has pixels: png or sl1", machine.name())
        }
    }
}

/// The layers to write.
struct Selection {
    part: Placed,
    range: Range<u32>,
    threads: usize,
}

impl Selection {
    /// The names of the part's materials, if it has several.
    fn materials(&self) -> Option<&[String]> {
        let materials = self.part.header().materials.as_ref()?;
        Some(&*materials.names).filter(|names| names.len() > 1)
    }

    /// Computes the masks of the layers one after the other, one for each material, and hands them to `write`, with the layer's number. Shows the
    /// progress.
    fn masks(self, mut write: impl FnMut(u32, &[Bitmap]) -> anyhow::Result<()>) -> anyhow::Result<()> {
        let mut slicer = self.part.mask_slicer(self.threads, self.range.start)?;
        let mut masks = slicer.dark_masks();
        let bar = super::progress_bar("{bar:40} {pos}/{len} layers, {eta} left");
        bar.set_length(u64::from(self.range.end - self.range.start));
        for _ in self.range {
            let Some(layer) = slicer.next_layer(&mut masks)? else { bail!("the layers ended too early") };
            write(layer, &masks)?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// Computes the layers one after the other and hands each to `write`, with its number. Shows the progress.
    fn pictures(self, mut write: impl FnMut(u32, &Bitmap) -> anyhow::Result<()>) -> anyhow::Result<()> {
        let SlicePlan { raster, depth, .. } = *self.part.plan();
        let mut bitmap = Bitmap::new(raster.width_px, raster.height_px, depth);
        let mut slicer = self.part.slicer(self.threads, self.range.start)?;
        let bar = super::progress_bar("{bar:40} {pos}/{len} layers, {eta} left");
        bar.set_length(u64::from(self.range.end - self.range.start));
        for _ in self.range {
            let Some(layer) = slicer.next_layer(&mut bitmap)? else { bail!("the layers ended too early") };
            write(layer, &bitmap)?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(())
    }
}

fn cannot_write(path: &Path) -> String {
    format!("cannot write {}; is the disk full or the directory read-only?", path.display())
}

fn layers_within(wanted: Option<LayerRange>, layer_count: u32) -> anyhow::Result<Range<u32>> {
    let LayerRange { first, end } = wanted.unwrap_or(LayerRange { first: 0, end: None });
    let end = end.unwrap_or(layer_count);
    ensure!(
        first < layer_count && end <= layer_count,
        "--layers {first}..{end}: the part has {}: 0..{layer_count}",
        count_text(layer_count.into(), "layer")
    );
    Ok(first..end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_and_empty_ones_refused() {
        assert_eq!(parse_layers("3..5"), Ok(LayerRange { first: 3, end: Some(5) }));
        assert_eq!(parse_layers(".."), Ok(LayerRange { first: 0, end: None }));
        for wrong in ["", "5", "5..5", "6..5", "-1..2", "a..b"] {
            assert!(parse_layers(wrong).is_err(), "{wrong}");
        }
        assert!(layers_within(parse_layers("0..11").ok(), 10).is_err());
        assert_eq!(layers_within(parse_layers("8..").ok(), 10).expect("within"), 8..10);
    }
}
