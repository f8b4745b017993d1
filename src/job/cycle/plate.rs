//! What every cycle knows of its plate: where layers are exposed, and how long a move may take. `vat.rs` and `powder.rs` use it.

use super::Step;
use crate::device::{Act, least_move_us};
use crate::job::ACT_MARGIN_US;
use crate::link::message::DeviceState;

/// Longest homing. From the largest build height (2 m) at 10 mm/s it takes 200 s.
pub(super) const HOMING_US: u64 = 300_000_000;

/// Positions of a plate for layers of one height, micrometres from the plane in which layers are exposed: upwards in a vat, downwards in
/// a bed of powder.
#[derive(Clone, Copy, Debug)]
pub(super) struct LayerPositions {
    pub(super) layer_height_um: f64,
}

impl LayerPositions {
    /// Height of a part.
    pub(super) fn part_height_um(self, layer_count: u32) -> f64 {
        f64::from(layer_count) * self.layer_height_um
    }

    /// Where the plate is while a layer is exposed: one layer height for layer 0.
    pub(super) fn layer_um(self, layer: u32) -> i32 {
        // `as` saturates: a position that no plate can reach stays out of reach.
        (f64::from(layer + 1) * self.layer_height_um).round() as i32
    }

    /// Tolerance of a position: half a layer. Beyond that the part would be wrong beyond repair.
    fn tolerance_um(self) -> u32 {
        (self.layer_height_um / 2.0) as u32
    }

    /// Whether a position is wrong.
    pub(super) fn is_off(self, position_um: i32, to_um: i32) -> bool {
        position_um.abs_diff(to_um) > self.tolerance_um()
    }

    /// The step that moves the plate by `act`.
    pub(super) fn travel(self, act: Act, from_um: Option<i32>, to_um: i32, speed_um_s: u32) -> Step {
        let distance_um = to_um.abs_diff(from_um.unwrap_or(0));
        let travel_us = u64::from(distance_um) * 1_000_000 / u64::from(speed_um_s.max(1));
        // The move may end this much short of its target.
        let least_um = distance_um.saturating_sub(self.tolerance_um());
        Step::Act { act, most_us: travel_us + ACT_MARGIN_US, least_us: least_move_us(least_um, speed_um_s) }
    }

    /// Compares where the plate is with where it was left, and takes over where it is. Returns where it was left if it has moved.
    pub(super) fn moved(self, position_um: &mut Option<i32>, state: &DeviceState) -> Option<i32> {
        let left_um = (*position_um)?;
        if state.position_um.is_some_and(|found_um| !self.is_off(found_um, left_um)) {
            return None;
        }
        *position_um = state.position_um;
        Some(left_um)
    }
}
