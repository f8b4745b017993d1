//! Depths and times of a print in a bed of powder, computed from machine, recipe and the number of a layer. See [`PowderPlan`] used
//! in `job/cycle/powder.rs` (depths) and in `layerctl check` (times).

use std::ops::Range;

use crate::config::SlmRecipe;

/// What a print in a bed of powder must know of recipe and machine.
#[derive(Clone, Debug, PartialEq)]
pub struct PowderPlan {
    /// Layer height, speeds and waits.
    pub recipe: Box<SlmRecipe>,
    /// Time that the recoater takes ([`crate::config::SlmMachine::recoat_ms`]).
    pub recoat_ms: u32,
}

impl PowderPlan {
    /// Height of a part, micrometres.
    pub(super) fn height_um(&self, layer_count: u32) -> f64 {
        f64::from(layer_count) * self.recipe.layer_height_um
    }

    /// Depth of the plate while a layer is marked, micrometres below the working plane: one layer height for layer 0.
    pub(super) fn layer_position_um(&self, layer: u32) -> i32 {
        // `as` saturates: a depth that no plate can reach stays out of reach.
        (f64::from(layer + 1) * self.recipe.layer_height_um).round() as i32
    }

    /// Tolerance of the plate position, micrometres: half a layer. Beyond that the part would be wrong beyond repair.
    pub(super) fn position_tolerance_um(&self) -> u32 {
        (self.recipe.layer_height_um / 2.0) as u32
    }

    /// Wait between recoating and marking, microseconds.
    pub(super) fn settle_us(&self) -> u64 {
        u64::from(self.recipe.wait_after_recoat_ms) * 1000
    }

    /// Time of these layers without marking, milliseconds: how long a layer is marked is known once it is computed.
    pub(in crate::job) fn layers_ms(&self, layers: Range<u32>) -> f64 {
        let travel_ms = self.recipe.layer_height_um / f64::from(self.recipe.plate_speed_um_s.max(1)) * 1e3;
        let each_ms = travel_ms + f64::from(self.recoat_ms) + f64::from(self.recipe.wait_after_recoat_ms);
        layers.len() as f64 * each_ms
    }
}
