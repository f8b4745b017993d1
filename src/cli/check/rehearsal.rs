//! All layers of scan vectors, computed as a print computes them: what each takes of the memory budget, how long it is marked, and what is
//! not marked. `check` shows it, so that no print ends in the middle for lack of memory. `tests/check/` holds it to what a print needs.

use anyhow::{Context, bail};
use serde::Serialize;

use super::{add_layers, layers_text};
use crate::device::encoding::Choice;
use crate::pipeline::{Part, PrintMemory};
use crate::stream::MemoryBudget;
use crate::text::{count_text, size_text};

/// Memory to compute layers with, at least, bytes: a layer that does not fit the budget is to be computed all the same, to say how much it
/// needs.
const MIN_ROOM_BYTES: u64 = 1 << 30;

/// The room is this many times the budget.
const ROOM_BUDGETS: u64 = 4;

/// What computing all layers showed.
#[derive(Debug, Serialize)]
pub(super) struct Rehearsal {
    /// The layer that takes most memory, and the least `memory_budget` with which a print computes it.
    pub(super) largest_layer: u32,
    pub(super) largest_layer_budget_bytes: u64,
    /// Ranges of layers, first to last, that do not fit the budget.
    pub(super) unfit_layers: Vec<[u32; 2]>,
    vectors_mean: u64,
    pub(super) mark_ms_mean: f64,
    /// Regions of all layers that get no mark.
    unmarked_parts: u64,
    /// Of the whole print, if the device never waits.
    pub(super) print_time_s: u64,
}

/// A budget that is large enough to compute layers that do not fit `budget`.
pub(super) fn roomy(budget: u64) -> MemoryBudget {
    MemoryBudget::new(budget.saturating_mul(ROOM_BUDGETS).max(MIN_ROOM_BYTES))
}

/// Computes all layers of a part, to be printed within `budget`. `rest_ms` is the time of all layers without marking.
///
/// # Errors
/// A layer cannot be computed at all.
pub(super) fn rehearse(
    part: &Part,
    memory: &PrintMemory,
    budget: u64,
    encoding: Choice,
    rest_ms: f64,
) -> anyhow::Result<Rehearsal> {
    let room = roomy(budget);
    let mut layers = part.encoded_layers(0, encoding, &room)?;
    let layer_count = part.layer_count();
    let bar = crate::cli::progress_bar("{bar:40} {pos}/{len} layers computed, {eta} left");
    bar.set_length(u64::from(layer_count));
    let mut found = Rehearsal {
        largest_layer: 0,
        largest_layer_budget_bytes: 0,
        unfit_layers: Vec::new(),
        vectors_mean: 0,
        mark_ms_mean: 0.0,
        unmarked_parts: 0,
        print_time_s: 0,
    };
    let (mut vectors, mut mark_ms) = (0, 0.0);
    for layer in 0..layer_count {
        let computed = layers.next().transpose().with_context(|| format!("layer {layer} cannot be computed"))?;
        let Some(scan) = computed.and_then(|computed| computed.scan) else { bail!("the layers ended too early") };
        let budget_bytes = memory.budget_of_layer(room.take_peak_bytes(), budget);
        if budget_bytes > found.largest_layer_budget_bytes {
            (found.largest_layer, found.largest_layer_budget_bytes) = (layer, budget_bytes);
        }
        if budget_bytes > budget {
            add_layers(&mut found.unfit_layers, [layer; 2]);
        }
        vectors += u64::from(scan.times.vectors);
        mark_ms += f64::from(scan.times.mark_ms);
        found.unmarked_parts += scan.counts.unmarked;
        bar.inc(1);
    }
    bar.finish_and_clear();
    found.vectors_mean = vectors / u64::from(layer_count.max(1));
    found.mark_ms_mean = mark_ms / f64::from(layer_count.max(1));
    found.print_time_s = ((rest_ms + mark_ms) / 1e3) as u64;
    Ok(found)
}

impl Rehearsal {
    /// What keeps the part from being printed within the budget.
    pub(super) fn problem(&self, budget: u64) -> Option<String> {
        if self.unfit_layers.is_empty() {
            return None;
        }
        Some(format!(
            "these layers do not fit the memory budget of {}: {}; layer {} needs most: set memory_budget = \"{}MiB\" in the \
             daemon's configuration",
            size_text(budget),
            layers_text(&self.unfit_layers),
            self.largest_layer,
            self.largest_layer_budget_bytes.div_ceil(1 << 20)
        ))
    }

    /// What may be missing from the part.
    pub(super) fn warning(&self) -> Option<String> {
        (self.unmarked_parts > 0).then(|| {
            format!(
                "{} without a mark: narrower than the laser can make, or than the recipe allows. `layerctl slice --format svg` shows \
                 what is marked",
                count_text(self.unmarked_parts, "region")
            )
        })
    }

    /// Lines for people.
    pub(super) fn lines(&self) -> [String; 2] {
        [
            format!("marking         {:.1} ms a layer, {}", self.mark_ms_mean, count_text(self.vectors_mean, "vector")),
            format!(
                "largest layer   {} needs a budget of {}",
                self.largest_layer,
                size_text(self.largest_layer_budget_bytes)
            ),
        ]
    }
}
