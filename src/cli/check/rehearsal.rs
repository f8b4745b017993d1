//! Layers of scan vectors, computed as a print computes them: what each takes of the memory budget, how long it is marked, and what is
//! not marked. All of them, or as many as there is time for. `check` shows it, so that no print is interrupted for lack of memory.
//! `tests/check/` holds it to what a print needs.

use anyhow::{Context, bail};
use serde::Serialize;

use super::layers_text;
use crate::device::encoding::Choice;
use crate::pipeline::{Part, PrintMemory};
use crate::slice::add_layers;
use crate::stream::MemoryBudget;
use crate::text::{count_text, size_text};

/// Memory to compute layers with, at least, bytes: a layer that does not fit the budget is to be computed all the same, to say how much it
/// needs.
const MIN_ROOM_BYTES: u64 = 1 << 30;

/// The room is this many times the budget.
const ROOM_BUDGETS: u64 = 4;

/// What computing layers showed.
#[derive(Debug, Serialize)]
pub(super) struct Rehearsal {
    /// Every how many layers one was computed, and how many that are.
    #[serde(skip)]
    step: u32,
    computed_layers: u32,
    /// The layer that takes most memory, and the least `memory_budget` with which a print computes it.
    pub(super) largest_layer: u32,
    pub(super) largest_layer_budget_bytes: u64,
    /// Ranges of layers, first to last, that do not fit the budget. A layer that was computed stands for those up to the next one.
    pub(super) unfit_layers: Vec<[u32; 2]>,
    vectors_mean: u64,
    pub(super) mark_ms_mean: f64,
    /// Regions of the computed layers that get no mark.
    unmarked_parts: u64,
    /// Of the whole print, if the device never waits.
    pub(super) print_time_s: u64,
}

/// A budget that is large enough to compute layers that do not fit `budget`.
pub(super) fn roomy(budget: u64) -> MemoryBudget {
    MemoryBudget::new(budget.saturating_mul(ROOM_BUDGETS).max(MIN_ROOM_BYTES))
}

/// Every how many layers one is computed in about `minutes`, if a layer takes `layer_ms`.
pub(super) fn step(layer_count: u32, layer_ms: f64, minutes: f64) -> u32 {
    let all_minutes = f64::from(layer_count) * layer_ms / 60e3;
    ((all_minutes / minutes).ceil() as u32).clamp(1, layer_count.max(1))
}

/// Computes every layer of a part, or each after `step` layers, to be printed within `budget`. `rest_ms` is the time of all layers without
/// marking.
///
/// # Errors
/// A layer cannot be computed at all.
pub(super) fn rehearse(
    part: &Part,
    memory: &PrintMemory,
    budget: u64,
    encoding: Choice,
    rest_ms: f64,
    step: u32,
) -> anyhow::Result<Rehearsal> {
    let room = roomy(budget);
    let layer_count = part.layer_count();
    // All layers are computed in one sweep, and others in a sweep each.
    let (stride, length) = if step == 1 { (layer_count.max(1), layer_count) } else { (step, 1) };
    let bar = crate::cli::progress_bar("{bar:40} {pos}/{len} layers computed, {eta} left");
    bar.set_length(u64::from(layer_count.div_ceil(step)));
    let mut found = Rehearsal {
        step,
        computed_layers: 0,
        largest_layer: 0,
        largest_layer_budget_bytes: 0,
        unfit_layers: Vec::new(),
        vectors_mean: 0,
        mark_ms_mean: 0.0,
        unmarked_parts: 0,
        print_time_s: 0,
    };
    let (mut vectors, mut mark_ms) = (0, 0.0);
    for first in (0..layer_count).step_by(stride as usize) {
        let mut layers = part.encoded_layers(first, encoding, &room)?;
        for layer in first..first + length {
            let computed = layers.next().transpose().with_context(|| format!("layer {layer} cannot be computed"))?;
            let Some(scan) = computed.and_then(|computed| computed.scan) else { bail!("the layers ended too early") };
            let budget_bytes = memory.budget_of_layer(room.take_peak_bytes(), budget);
            if budget_bytes > found.largest_layer_budget_bytes {
                (found.largest_layer, found.largest_layer_budget_bytes) = (layer, budget_bytes);
            }
            if budget_bytes > budget {
                add_layers(&mut found.unfit_layers, [layer, (layer + step).min(layer_count) - 1]);
            }
            vectors += u64::from(scan.times.vectors);
            mark_ms += f64::from(scan.times.mark_ms);
            found.unmarked_parts += scan.counts.unmarked;
            found.computed_layers += 1;
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    let computed = found.computed_layers.max(1);
    found.vectors_mean = vectors / u64::from(computed);
    found.mark_ms_mean = mark_ms / f64::from(computed);
    found.print_time_s = ((rest_ms + found.mark_ms_mean * f64::from(layer_count)) / 1e3) as u64;
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

    /// What is not known, if not all of `layer_count` layers were computed in `minutes`.
    pub(super) fn gap(&self, layer_count: u32, minutes: f64) -> Option<String> {
        (self.step > 1).then(|| {
            format!(
                "{} of {layer_count} layers were computed, because all take longer than {minutes} minutes: one between them may need \
                 more memory, and would interrupt the print until memory_budget is larger. --minutes {:.0} is about enough for all",
                self.computed_layers,
                (minutes * f64::from(self.step)).ceil()
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

#[cfg(test)]
mod tests {
    use super::step;

    #[test]
    fn layers_are_left_out_only_if_all_take_too_long() {
        assert_eq!(step(6000, 100.0, 10.0), 1);
        assert_eq!(step(6000, 101.0, 10.0), 2);
        assert_eq!(step(4000, 3000.0, 10.0), 20);
        assert_eq!(step(3, 1e9, 10.0), 3);
        assert_eq!(step(0, 1e9, 10.0), 1);
    }
}
