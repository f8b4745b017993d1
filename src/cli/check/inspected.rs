//! What layers show of a part's shape: walls of solids that pixels cannot form, what is enclosed more than once, and a top that is dark.
//! `tests/check/walls.rs` tests it.

use std::time::Duration;

use serde::Serialize;

use super::layers_text;
use crate::buildfile::{BodyHeader, Header};
use crate::pipeline::Part;
use crate::slice::{Inspection, SlicePlan};

/// Most time for looking at layers of solids: nobody would wait much longer for a check.
const MAX_TIME: Duration = Duration::from_secs(10);

/// What was found.
#[derive(Debug, Serialize)]
pub(super) struct Inspected {
    /// Layers whose solids were looked at; 0 of a part without solids.
    inspected_layers: u32,
    /// Ranges of layers, first to last, with walls of solids that are thinner than a pixel, and the thickness of one of them.
    thin_wall_layers: Vec<[u32; 2]>,
    thin_wall_px: Option<f64>,
    /// Ranges of layers in which surfaces enclose something more than once.
    enclosed_twice_layers: Vec<[u32; 2]>,
    /// Layers at the top in which nothing is lit, of the last 16.
    dark_top_layers: u32,
    #[serde(skip)]
    warnings: Vec<String>,
}

impl Inspected {
    /// What may spoil the print, in words.
    pub(super) fn warnings(&self) -> impl Iterator<Item = String> {
        self.warnings.iter().cloned()
    }
}

/// Looks at the layers of a part.
///
/// # Errors
/// A layer cannot be computed.
pub(super) fn inspect(part: &Part, header: &Header, plan: &SlicePlan, budget: u64) -> anyhow::Result<Inspected> {
    let bar = crate::cli::progress_bar("{bar:40} {pos}/{len} layers inspected, {eta} left");
    bar.set_length(u64::from(plan.layer_count));
    let found = part.inspect(MAX_TIME, |layer| bar.set_position(u64::from(layer) + 1))?;
    bar.finish_and_clear();
    let dark_top_layers = part.dark_top_layers(budget)?;
    let warnings = thin_text(&found, plan).into_iter().chain(enclosed_text(&found));
    let warnings = warnings.chain(dark_text(dark_top_layers, header, plan)).collect();
    Ok(Inspected {
        inspected_layers: found.looked_at,
        thin_wall_px: found.thinnest.map(|wall| wall.thickness_px),
        thin_wall_layers: found.thin,
        enclosed_twice_layers: found.enclosed_twice,
        dark_top_layers,
        warnings,
    })
}

fn thin_text(found: &Inspection, plan: &SlicePlan) -> Option<String> {
    let wall = found.thinnest?;
    let [column, row] = wall.pixel;
    let looked_at = if found.looked_at < plan.layer_count {
        format!(" ({} of {} layers were looked at)", found.looked_at, plan.layer_count)
    } else {
        String::new()
    };
    Some(format!(
        "walls thinner than a pixel are in layers {}{looked_at}, for example one of {:.2} pixels at column {column}, row {row} of layer \
         {}: they may print broken, or not at all",
        layers_text(&found.thin),
        wall.thickness_px,
        wall.layer
    ))
}

fn enclosed_text(found: &Inspection) -> Option<String> {
    (!found.enclosed_twice.is_empty()).then(|| {
        format!(
            "surfaces enclose something more than once in layers {}: pieces overlap, or one lies within another and faces the same way. It \
             is solid, as if it were enclosed once; for a cavity, turn the inner surface inside out",
            layers_text(&found.enclosed_twice)
        )
    })
}

/// Says nothing of lattices, because the bounds of a convolution are higher than what prints. Says nothing of a last layer that the part fills
/// by less than half.
fn dark_text(layers: u32, header: &Header, plan: &SlicePlan) -> Option<String> {
    let first = plan.layer_count - layers;
    let tops = header.bodies.iter().filter_map(|body| match body {
        BodyHeader::Surface(surface) => Some(surface.bounds.max[2]),
        BodyHeader::Relief(relief) => Some(relief.bounds.max[2]),
        BodyHeader::Lattice(_) | BodyHeader::Clip(_) => None,
    });
    let top_um = f64::from(tops.max()?) * header.quantum_um;
    (layers > 0 && plan.layer_z_um(first) < top_um)
        .then(|| format!("nothing is lit from layer {first} on: the top of the part is too thin for these pixels"))
}
