//! `layerctl slice --format png`: a directory of pictures, with a manifest of where each lies. `tests/check/` compares them with the
//! mathematics.

use std::io::Write;
use std::path::Path;

use anyhow::{Context, ensure};
use serde::Serialize;

use super::{Selection, cannot_write};
use crate::buildfile::{BodyHeader, Header};
use crate::cli;
use crate::layer::export::{write_colours, write_png};
use crate::layer::{Bitmap, Mirror};
use crate::output::Output;
use crate::slice::SlicePlan;
use crate::solid::ISOVALUE;
use crate::text::count_text;

/// Writes the pictures and the manifest into a directory, which is made if it is missing.
pub(super) fn write(selection: Selection, output: &Path) -> anyhow::Result<()> {
    ensure!(!output.is_file(), "{} is a file; -o wants a directory for the pictures", output.display());
    std::fs::create_dir_all(output).with_context(|| format!("cannot make the directory {}", output.display()))?;
    let manifest_path = output.join("manifest.json");
    // If this run fails, an earlier manifest would describe the wrong pictures.
    match std::fs::remove_file(&manifest_path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(error).with_context(|| cannot_write(&manifest_path));
        }
        _ => {}
    }
    let plan = selection.part.plan().clone();
    let mut manifest = Manifest::new(selection.part.header(), &plan);
    let z_mm = |layer: u32| plan.layer_z_um(layer) / 1000.0;
    if let Some(names) = selection.materials() {
        manifest.materials = names.to_vec();
        selection.masks(|layer, masks| {
            manifest.layers.push(write_masks(output, layer, masks, z_mm(layer))?);
            Ok(())
        })?;
    } else {
        selection.pictures(|layer, bitmap| {
            let file = format!("layer_{layer:06}.png");
            let path = output.join(&file);
            write_png(&path, bitmap).with_context(|| cannot_write(&path))?;
            manifest.layers.push(LayerEntry { file, masks: Vec::new(), z_mm: z_mm(layer) });
            Ok(())
        })?;
    }
    manifest.write(&manifest_path)?;
    let others = manifest.other_pictures(output)?;
    if others > 0 {
        cli::eprint(&format!(
            "note: {} of layers, from another run, left in {}; manifest.json does not name them",
            count_text(others as u64, "more picture"),
            output.display()
        ));
    }
    cli::print(&format!(
        "{} and manifest.json in {}",
        count_text(manifest.layers.len() as u64, "layer"),
        output.display()
    ))
}

/// Writes a layer in colour, and a picture of each of its materials.
fn write_masks(directory: &Path, layer: u32, masks: &[Bitmap], z_mm: f64) -> anyhow::Result<LayerEntry> {
    let file = format!("layer_{layer:06}.png");
    let path = directory.join(&file);
    write_colours(&path, masks).with_context(|| cannot_write(&path))?;
    let mut names = Vec::new();
    for (number, mask) in masks.iter().enumerate() {
        let name = format!("layer_{layer:06}_material_{}.png", number + 1);
        let path = directory.join(&name);
        write_png(&path, mask).with_context(|| cannot_write(&path))?;
        names.push(name);
    }
    Ok(LayerEntry { file, masks: names, z_mm })
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
    /// Names of the materials, if there are several, in the order of `masks`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    materials: Vec<String>,
    source_digest: String,
    layers: Vec<LayerEntry>,
}

/// One body of the part.
#[derive(Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum BodyEntry {
    Lattice {
        joint: &'static str,
        /// R of a convolution surface; `null` for a union.
        support_mm: Option<f64>,
    },
    Surface,
    Relief,
    /// A surface that clips the lattice before it.
    Clip {
        /// What is left: `inside` or `outside`.
        keeps: &'static str,
    },
}

#[derive(Debug, Serialize)]
struct LayerEntry {
    /// The layer; in colour if there are several materials.
    file: String,
    /// What is of each material.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    masks: Vec<String>,
    z_mm: f64,
}

impl Manifest {
    fn new(header: &Header, plan: &SlicePlan) -> Self {
        let body = |body: &BodyHeader| match body {
            BodyHeader::Lattice(lattice) => {
                let (joint, support_mm) = cli::joint_figures(lattice.joint);
                BodyEntry::Lattice { joint, support_mm }
            }
            BodyHeader::Surface(_) => BodyEntry::Surface,
            BodyHeader::Relief(_) => BodyEntry::Relief,
            BodyHeader::Clip(clip) => BodyEntry::Clip { keeps: cli::keeps_text(clip.keeps) },
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
            materials: Vec::new(),
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
        let named: usize = self.layers.iter().map(|layer| 1 + layer.masks.len()).sum();
        Ok(found.saturating_sub(named))
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
