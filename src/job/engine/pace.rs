//! How fast the print goes: late layers, and the time that is left.

use crate::job::JobPlan;

/// A layer is late where the machine stood still for longer than this in its cycle. Three orders cross even a slow line in less.
const LATE_US: u64 = 250_000;
/// The pace is a mean over at most about this many layers: enough to even out single waits, few enough to follow a change.
const MAX_LAYERS_AVERAGED: u32 = 16;

/// Observed from layer to layer.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// When the layer before was confirmed; `None` where a pause or a lost line lies between.
    confirmed_us: Option<u64>,
    /// What a layer takes beyond its planned time in the mean, microseconds.
    excess_us: f64,
    layers_averaged: u32,
    /// Standstill in the present layer's cycle.
    waited_us: u64,
    pub(super) late_layers: u32,
    pub(super) late_us_total: u64,
}

impl Pace {
    /// The machine stood still, dark, waiting for a layer or for an order.
    pub(super) fn waited(&mut self, us: u64) {
        self.waited_us += us;
    }

    /// The cycle under way is not one to measure by: a pause, a lost line, a new start.
    pub(super) fn break_off(&mut self) {
        self.confirmed_us = None;
    }

    /// A layer was confirmed whose cycle was planned to take `planned_ms`.
    pub(super) fn confirmed(&mut self, planned_ms: u64, now_us: u64) {
        if self.waited_us > LATE_US {
            self.late_layers += 1;
            self.late_us_total += self.waited_us;
        }
        self.waited_us = 0;
        if let Some(before_us) = self.confirmed_us.replace(now_us) {
            let excess_us = (now_us - before_us) as f64 - planned_ms as f64 * 1000.0;
            self.layers_averaged = MAX_LAYERS_AVERAGED.min(self.layers_averaged + 1);
            self.excess_us += (excess_us - self.excess_us) / f64::from(self.layers_averaged);
        }
    }

    /// Time until the last layer is done, milliseconds.
    pub(super) fn remaining_ms(&self, plan: &JobPlan, next_layer: u32) -> u64 {
        let layers = f64::from(plan.layer_count.saturating_sub(next_layer));
        let excess_ms = layers * self.excess_us / 1000.0;
        // `as` saturates: less than nothing is nothing.
        (plan.remaining_ms(next_layer) as f64 + excess_ms) as u64
    }
}
