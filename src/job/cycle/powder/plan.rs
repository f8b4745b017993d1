//! Depths and times of a print in a bed of powder, computed from machine, recipe and the number of a layer. See [`PowderPlan`] used
//! in `job/cycle/powder.rs` (depths) and in `layerctl check` (times).

use std::ops::Range;

use crate::config::SlmRecipe;
use crate::job::cycle::plate::LayerPositions;

/// What a print in a bed of powder must know of recipe and machine.
#[derive(Clone, Debug, PartialEq)]
pub struct PowderPlan {
    /// Layer height, speeds and waits.
    pub recipe: Box<SlmRecipe>,
    /// Time that the recoater takes ([`crate::config::SlmMachine::recoat_ms`]).
    pub recoat_ms: u32,
}

impl PowderPlan {
    /// Depths of the plate below the working plane.
    pub(super) fn positions(&self) -> LayerPositions {
        LayerPositions { layer_height_um: self.recipe.layer_height_um }
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
