//! Heights and times of a job, computed from recipe and layer number.

use crate::config::DlpRecipe;

/// A job as the engine must know it.
#[derive(Clone, Debug, PartialEq)]
pub struct JobPlan {
    /// Names the job's exposures; random, never 0.
    pub key: u64,
    /// Number of layers.
    pub layer_count: u32,
    /// Exposures, lifts and waits.
    pub recipe: DlpRecipe,
    /// Plate height clear of the resin, micrometres above the bottom of the vat
    /// ([`crate::config::DlpMachine::clear_height_um`]).
    pub clear_height_um: f64,
    /// How much faster than real time the device's clock runs ([`crate::config::Machine::time_scale`]).
    pub time_scale: f64,
}

impl JobPlan {
    /// Height of the plate while a layer is exposed, micrometres above the bottom of the vat: one layer height for layer 0.
    pub fn layer_position_um(&self, layer: u32) -> i32 {
        // `as` saturates: a height that no plate can reach stays out of reach.
        (f64::from(layer + 1) * self.recipe.layer_height_um).round() as i32
    }

    /// Converts a duration of the device's clock to the host's clock, microseconds.
    pub fn host_us(&self, device_us: u64) -> u64 {
        (device_us as f64 / self.time_scale) as u64
    }

    /// Tolerance of the plate position, micrometres: half a layer. Beyond that the part would be wrong beyond repair.
    pub fn position_tolerance_um(&self) -> u32 {
        (self.recipe.layer_height_um / 2.0) as u32
    }

    /// Height after the lift that frees a layer, not limited to the device's travel, micrometres.
    pub fn lifted_position_um(&self, layer: u32) -> i32 {
        let lift_um = i32::try_from(self.recipe.lift_height_um).unwrap_or(i32::MAX);
        self.layer_position_um(layer).saturating_add(lift_um)
    }

    /// Height at which the plate rests when the job pauses or ends before `next_layer`, micrometres: clear of the resin and no
    /// lower than a lift, not limited to the device's travel.
    pub fn parked_position_um(&self, next_layer: u32) -> i32 {
        let lifted_um = next_layer.checked_sub(1).map_or(0, |exposed| self.lifted_position_um(exposed));
        lifted_um.max(self.clear_height_um.ceil() as i32)
    }

    /// Time the machine needs for the layers from `next_layer` on if none is late, milliseconds. Moves count at their speed,
    /// without ramps.
    pub fn remaining_ms(&self, next_layer: u32) -> u64 {
        let recipe = &self.recipe;
        let first_normal = recipe.bottom_layers.saturating_add(recipe.transition_layers).min(self.layer_count);
        let special = (next_layer..first_normal).map(|layer| u64::from(recipe.layer_exposure_ms(layer))).sum::<u64>();
        let normal_count = u64::from(self.layer_count.saturating_sub(next_layer.max(first_normal)));
        let layers = u64::from(self.layer_count.saturating_sub(next_layer));
        special + normal_count * u64::from(recipe.exposure_ms) + layers * self.dark_ms()
    }

    /// Time the machine needs for a layer if it is not late, milliseconds.
    pub fn layer_ms(&self, layer: u32) -> u64 {
        u64::from(self.recipe.layer_exposure_ms(layer)) + self.dark_ms()
    }

    /// Time of a layer without light, milliseconds.
    fn dark_ms(&self) -> u64 {
        let recipe = &self.recipe;
        let waits_ms = [
            recipe.light_off_delay_ms,
            recipe.wait_before_exposure_ms,
            recipe.wait_after_exposure_ms,
            recipe.wait_after_lift_ms,
        ];
        let lift_um = u64::from(recipe.lift_height_um);
        waits_ms.iter().map(|ms| u64::from(*ms)).sum::<u64>()
            + lift_um * 1000 / u64::from(recipe.lift_speed_um_s.max(1))
            + lift_um * 1000 / u64::from(recipe.retract_speed_um_s.max(1))
    }
}
