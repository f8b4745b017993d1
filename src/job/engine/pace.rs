//! How fast the print goes: late layers, and the time that is left. Tested by `tests/job_lies/answers.rs`.

use crate::job::JobPlan;

/// A layer is late if the machine stood still for longer than this in its cycle. Even on a slow line three orders take less.
const LATE_US: u64 = 250_000;
/// The pace is a mean over about this many layers: enough to smooth out single waits, few enough to follow a change.
const MAX_LAYERS_AVERAGED: u32 = 16;

/// The pace of the print.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// When the previous layer was confirmed; `None` after a pause or a lost line.
    confirmed_us: Option<u64>,
    /// Mean time that a layer takes beyond its planned time, microseconds.
    excess_us: f64,
    layers_averaged: u32,
    /// Standstill in the cycle of the present layer.
    waited_us: u64,
    pub(super) late_layers: u32,
    pub(super) late_us_total: u64,
    /// Light time that the device reported for the layer confirmed last, milliseconds.
    pub(super) light_ms: Option<u32>,
}

impl Pace {
    /// The machine stood still, dark, waiting for a layer or for an order.
    pub(super) fn waited(&mut self, us: u64) {
        self.waited_us += us;
    }

    /// The cycle under way does not count: it contains a pause, a lost line or a restart.
    pub(super) fn break_off(&mut self) {
        self.confirmed_us = None;
    }

    /// A layer was confirmed whose cycle was planned to take `planned_ms`. `light_ms` is its reported light time, if there is one.
    pub(super) fn confirmed(&mut self, planned_ms: f64, light_ms: Option<u32>, now_us: u64) {
        self.light_ms = light_ms;
        if self.waited_us > LATE_US {
            self.late_layers += 1;
            self.late_us_total += self.waited_us;
        }
        self.waited_us = 0;
        if let Some(before_us) = self.confirmed_us.replace(now_us) {
            let excess_us = (now_us - before_us) as f64 - planned_ms * 1000.0;
            self.layers_averaged = MAX_LAYERS_AVERAGED.min(self.layers_averaged + 1);
            self.excess_us += (excess_us - self.excess_us) / f64::from(self.layers_averaged);
        }
    }

    /// Time until the last layer is done, milliseconds.
    pub(super) fn remaining_ms(&self, plan: &JobPlan, next_exposure: u32) -> u64 {
        let exposures = f64::from(plan.passes.exposure_count().saturating_sub(next_exposure));
        let excess_ms = exposures * self.excess_us / 1000.0;
        // `as` saturates: a negative sum becomes 0.
        (plan.remaining_ms(next_exposure) + excess_ms) as u64
    }
}
