//! `layerctl slice`: writes the layers that a print would send, as PNG, with a manifest of where each lies.
//! `tests/check.rs` compares its pictures with the mathematics.

use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::builder::RangedU64ValueParser;
use serde::Serialize;

use crate::buildfile::{BodyHeader, Header};
use crate::layer::export::write_png;
use crate::layer::{Bitmap, Depth, Mirror};
use crate::output::Output;
use crate::pipeline::{Placed, Resolution};
use crate::slice::{SlicePlan, Slicer};
use crate::solid::ISOVALUE;
use crate::text::count_text;

/// Write the layers of a part as pictures, the same that a print sends.
#[derive(Debug, clap::Args)]
#[command(after_help = super::with_names("\
Examples:
  layerctl slice lattice.layerd --machine lcd-4k-35um --recipe fine -o layers
  layerctl slice lattice.layerd -m sim-dlp --layers 100..110 --antialias -o some    layers 100 to 109

manifest.json says where each picture lies in the build file's coordinates: `origin_mm` is the centre of the first pixel. `z_mm` is \
the middle of a layer, above the part's lowest point. `source_digest` is that of the file that was packed. A grey value is about the \
share of the pixel that is inside the part."))]
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
    /// Directory for manifest.json and layer_000000.png, layer_000001.png, … (8 bits a pixel: 0 and 255, or grey); made if missing
    #[arg(long, short)]
    pub output: PathBuf,
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
    let SliceArgs { file, machine, recipe, layer_height, layers, antialias, threads, output } = args;
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

    ensure!(!output.is_file(), "{} is a file; -o wants a directory for the pictures", output.display());
    std::fs::create_dir_all(&output).with_context(|| format!("cannot make the directory {}", output.display()))?;
    let manifest_path = output.join("manifest.json");
    // If this run fails, an earlier manifest would describe the wrong pictures.
    match std::fs::remove_file(&manifest_path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(error).with_context(|| cannot_write(&manifest_path));
        }
        _ => {}
    }
    let mut manifest = Manifest::new(part.header(), part.plan());
    let Resolution { raster, depth, .. } = resolution;
    let mut bitmap = Bitmap::new(raster.width_px, raster.height_px, depth);
    let mut slicer = part.slicer(threads, range.start)?;
    let bar = super::progress_bar("{bar:40} {pos}/{len} layers, {eta} left");
    bar.set_length(u64::from(range.end - range.start));
    for _ in range {
        let Some(layer) = slicer.next_layer(&mut bitmap)? else { bail!("the layers ended too early") };
        let name = format!("layer_{layer:06}.png");
        let path = output.join(&name);
        write_png(&path, &bitmap).with_context(|| cannot_write(&path))?;
        manifest.layers.push(LayerEntry { file: name, z_mm: slicer.plan().layer_z_um(layer) / 1000.0 });
        bar.inc(1);
    }
    bar.finish_and_clear();
    manifest.write(&manifest_path)?;
    let others = manifest.other_pictures(&output)?;
    if others > 0 {
        super::eprint(&format!(
            "note: {} of layers, from another run, left in {}; manifest.json does not name them",
            count_text(others as u64, "more picture"),
            output.display()
        ));
    }
    super::print(&format!(
        "{} and manifest.json in {}",
        count_text(manifest.layers.len() as u64, "layer"),
        output.display()
    ))
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

/// `manifest.json`.
#[derive(Debug, Serialize)]
struct Manifest {
    width_px: u32,
    height_px: u32,
    pixel_um: [f64; 2],
    /// Where the centre of the first pixel lies in the build file's coordinates.
    origin_mm: [f64; 2],
    mirror: Mirror,
    layer_height_um: f64,
    isovalue: f64,
    bodies: Vec<BodyEntry>,
    source_digest: String,
    layers: Vec<LayerEntry>,
}

/// One body of the part.
#[derive(Debug, Serialize)]
struct BodyEntry {
    kind: &'static str,
    blend: &'static str,
    /// R of a convolution surface; `null` for a union.
    support_mm: Option<f64>,
}

#[derive(Debug, Serialize)]
struct LayerEntry {
    file: String,
    z_mm: f64,
}

impl Manifest {
    fn new(header: &Header, plan: &SlicePlan) -> Self {
        let body = |BodyHeader::Lattice(lattice): &BodyHeader| {
            let (blend, support_mm) = super::blend_figures(lattice.blend);
            BodyEntry { kind: "lattice", blend, support_mm }
        };
        Self {
            width_px: plan.raster.width_px,
            height_px: plan.raster.height_px,
            pixel_um: plan.raster.pixel_um,
            origin_mm: plan.origin_um.map(|x| x / 1000.0),
            mirror: plan.raster.mirror,
            layer_height_um: plan.layer_height_um,
            isovalue: ISOVALUE,
            bodies: header.bodies.iter().map(body).collect(),
            source_digest: header.source_digest.iter().map(|byte| format!("{byte:02x}")).collect(),
            layers: Vec::new(),
        }
    }

    /// Number of layer pictures in the directory that the manifest does not name.
    fn other_pictures(&self, directory: &Path) -> anyhow::Result<usize> {
        let is_picture = |name: &str| name.starts_with("layer_") && name.ends_with(".png");
        let mut found = 0;
        for entry in std::fs::read_dir(directory).with_context(|| format!("cannot read {}", directory.display()))? {
            found += usize::from(entry?.file_name().to_str().is_some_and(is_picture));
        }
        Ok(found.saturating_sub(self.layers.len()))
    }

    fn write(&self, path: &Path) -> anyhow::Result<()> {
        let text = serde_json::to_string_pretty(self)?;
        let write = || {
            let output = Output::create(path)?;
            output.file().write_all(text.as_bytes())?;
            output.publish()
        };
        write().with_context(|| cannot_write(path))
    }
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
