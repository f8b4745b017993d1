//! Heights and times of a print in a vat, computed from the recipe and the number of a layer. See [`VatPlan`] used in
//! `job/cycle/vat.rs` (heights) and in `layerctl check` (times).

use std::ops::Range;

use crate::config::DlpRecipe;
use crate::job::cycle::plate::LayerPositions;

/// What a print in a vat must know of recipe and machine.
#[derive(Clone, Debug, PartialEq)]
pub struct VatPlan {
    /// Exposures, lifts and waits.
    pub recipe: DlpRecipe,
    /// Plate height clear of the resin, micrometres above the bottom of the vat
    /// ([`crate::config::DlpMachine::clear_height_um`]).
    pub clear_height_um: f64,
}

impl VatPlan {
    /// Heights of the plate above the bottom of the vat.
    pub(super) fn positions(&self) -> LayerPositions {
        LayerPositions { layer_height_um: self.recipe.layer_height_um }
    }

    /// Height after the lift that frees a layer, not limited to the device's travel, micrometres.
    pub(super) fn lifted_position_um(&self, layer: u32) -> i32 {
        let lift_um = i32::try_from(self.recipe.lift_height_um).unwrap_or(i32::MAX);
        self.positions().layer_um(layer).saturating_add(lift_um)
    }

    /// Height at which the plate rests when the job pauses or ends after layer `exposed`, if it has one, micrometres: clear of the resin and
    /// no lower than a lift, not limited to the device's travel.
    pub(super) fn parked_position_um(&self, exposed: Option<u32>) -> i32 {
        let lifted_um = exposed.map_or(0, |layer| self.lifted_position_um(layer));
        lifted_um.max(self.clear_height_um.ceil() as i32)
    }

    /// Wait between the plate's arrival and the light, microseconds.
    pub(super) fn settle_us(&self) -> u64 {
        (u64::from(self.recipe.light_off_delay_ms) + u64::from(self.recipe.wait_before_exposure_ms)) * 1000
    }

    /// Light time of a layer, milliseconds.
    pub(in crate::job) fn exposure_ms(&self, layer: u32) -> u32 {
        self.recipe.layer_exposure_ms(layer)
    }

    /// Time that the machine needs for a layer, milliseconds.
    pub(in crate::job) fn layer_ms(&self, layer: u32) -> f64 {
        f64::from(self.exposure_ms(layer)) + self.dark_ms()
    }

    /// Time that the machine needs for some layers, milliseconds.
    pub(in crate::job) fn layers_ms(&self, layers: Range<u32>) -> f64 {
        let recipe = &self.recipe;
        let first_normal = recipe.bottom_layers.saturating_add(recipe.transition_layers).min(layers.end);
        let special_ms: u64 = (layers.start..first_normal).map(|layer| u64::from(self.exposure_ms(layer))).sum();
        let normal_count = (layers.start.max(first_normal)..layers.end).len() as u64;
        let light_ms = special_ms + normal_count * u64::from(recipe.exposure_ms);
        light_ms as f64 + layers.len() as f64 * self.dark_ms()
    }

    /// Time of a layer without light, milliseconds.
    fn dark_ms(&self) -> f64 {
        let recipe = &self.recipe;
        let waits_ms = [
            recipe.light_off_delay_ms,
            recipe.wait_before_exposure_ms,
            recipe.wait_after_exposure_ms,
            recipe.wait_after_lift_ms,
        ];
        let travel_ms = |speed_um_s: u32| f64::from(recipe.lift_height_um) / f64::from(speed_um_s.max(1)) * 1e3;
        waits_ms.into_iter().map(f64::from).sum::<f64>()
            + travel_ms(recipe.lift_speed_um_s)
            + travel_ms(recipe.retract_speed_um_s)
    }
}
