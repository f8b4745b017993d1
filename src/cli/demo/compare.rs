//! Compares what a simulated printer made of each layer with what the slicer says of it. `.ci/run` and `tests/powder_print.rs` show
//! that they agree.

use std::path::Path;

use anyhow::{Context, bail};
use image::GrayImage;

use super::run_self;
use crate::cli;
use crate::config::{Machine, Recipe};
use crate::layer::Bitmap;
use crate::pipeline::{Placed, Resolution, default_threads};

/// Shares of a layer's area that may stay unmelted, and that may be melted beside it. A pixel at the border counts whole, although the
/// border runs through it.
const MOST_UNMELTED: f64 = 0.03;
const MOST_BESIDE: f64 = 0.03;

/// Slices the same part and compares every picture with what was exposed.
pub(super) fn pictures(directory: &Path, part: &Path, layers: u32) -> anyhow::Result<()> {
    let (machine, recipe) = (directory.join("machine.toml"), directory.join("recipe.toml"));
    let sliced = directory.join("sliced");
    run_self(&[
        "slice".as_ref(),
        part.as_ref(),
        "--machine".as_ref(),
        machine.as_ref(),
        "--recipe".as_ref(),
        recipe.as_ref(),
        "-o".as_ref(),
        sliced.as_ref(),
    ])?;
    for layer in 0..layers {
        if picture(directory, "exposed", layer)? != picture(directory, "sliced", layer)? {
            let (name, place) = (name(layer), directory.display());
            bail!("{name}: what was exposed is not what `layerctl slice` says; both are in {place}");
        }
    }
    cli::print(&format!("all {layers} exposed pictures match those of `layerctl slice`, pixel by pixel"))
}

/// Compares the area melted in every layer with the area of the layer.
pub(super) fn melted(directory: &Path, part: &Path, layers: u32) -> anyhow::Result<()> {
    let machine = Machine::load(&directory.join("machine.toml"))?;
    let recipe = Recipe::load(&directory.join("recipe.toml"))?;
    let resolution = Resolution::of(&machine, &recipe);
    let mut slicer = Placed::open(part, &resolution)?.slicer(default_threads(), 0)?;
    let mut bitmap = Bitmap::new(resolution.raster.width_px, resolution.raster.height_px, resolution.depth);
    let mut sum = Areas::default();
    for layer in 0..layers {
        slicer.next_layer(&mut bitmap)?.context("the layers ended too early")?;
        sum.add(&bitmap, &picture(directory, "exposed", layer)?);
    }
    let (unmelted, beside) = (sum.share(sum.unmelted), sum.share(sum.beside));
    let shares = format!("{:.2} % of its area unmelted, {:.2} % melted beside it", unmelted * 100.0, beside * 100.0);
    if unmelted > MOST_UNMELTED || beside > MOST_BESIDE {
        bail!("what was melted is not the part: {shares}; the pictures are in {}", directory.display());
    }
    cli::print(&format!("all {layers} layers were melted as sliced: {shares}"))
}

/// Numbers of pixels.
#[derive(Default)]
struct Areas {
    part: u64,
    unmelted: u64,
    beside: u64,
}

impl Areas {
    fn add(&mut self, part: &Bitmap, melted: &GrayImage) {
        let rows = part.data().chunks_exact(part.stride_bytes());
        for (row, melted) in rows.zip(melted.rows()) {
            for (x, melted) in melted.enumerate() {
                let is_part = row[x / 8] >> (7 - x % 8) & 1 > 0;
                let is_melted = melted.0[0] > 0;
                self.part += u64::from(is_part);
                self.unmelted += u64::from(is_part && !is_melted);
                self.beside += u64::from(is_melted && !is_part);
            }
        }
    }

    fn share(&self, pixels: u64) -> f64 {
        pixels as f64 / self.part.max(1) as f64
    }
}

fn name(layer: u32) -> String {
    format!("layer_{layer:06}.png")
}

fn picture(directory: &Path, of: &str, layer: u32) -> anyhow::Result<GrayImage> {
    let path = directory.join(of).join(name(layer));
    let picture = image::open(&path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(picture.into_luma8())
}
