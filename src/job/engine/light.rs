//! Light that was not commanded, or lasts longer than commanded. It is switched off, and nothing else is commanded until the
//! device reports dark. Tested by `tests/job_lies/light.rs`.

use super::ending::URGENT_US;
use super::{Engine, Phase};
use crate::deadline::Deadline;
use crate::device::{DARK_LIMIT_US, STAYS_LIT};
use crate::job::JobState;
use crate::link::message::{DeviceState, Urgent};

/// Polling interval while the engine waits for dark.
const ASK_FOR_DARK_US: u64 = 100_000;

impl Engine {
    /// Orders the light off. A pending abort is kept: it does that too.
    pub(super) fn put_light_off(&mut self) {
        if self.out.urgent != Some(Urgent::Abort) {
            self.out.urgent = Some(Urgent::LightOff);
        }
        self.light.put_off();
    }

    /// The device reports light that it must not have. The print ends once the device is dark.
    pub(super) fn on_uncommanded_light(&mut self, text: &str, now_us: u64) {
        if !self.light.must_wait() {
            self.out.notice(format!("{text}; it was told to switch its light off"));
        }
        self.put_light_off();
        self.intent.add_end(JobState::Interrupted, format!("{text}: look at the part and the device, then resume"));
        if self.out.act.is_some() {
            // The act was not handed out yet. Nothing is commanded before the device is dark.
            return self.withdraw(now_us);
        }
        match self.phase {
            Phase::Exposing { .. } => {
                self.wait_until(Phase::CuttingShort, now_us + URGENT_US);
            }
            Phase::Lost | Phase::Asking { .. } | Phase::Checking { .. } => self.darken(now_us),
            _ => self.reconsider(true, now_us),
        }
    }

    /// The end of the exposure is overdue. The light is switched off; the device's answer decides whether the print goes on.
    pub(super) fn on_overdue_light(&mut self, now_us: u64) {
        if let Some(text) = self.light.overdue() {
            self.out.notice(format!("{text}; it was told to switch its light off"));
        }
        self.cut_short(now_us);
    }

    /// Waits until the device has answered the light-off and reports dark. The order is repeated until then.
    pub(super) fn darken(&mut self, now_us: u64) {
        self.out.query = true;
        self.wait_until(Phase::Darkening { until_us: now_us + DARK_LIMIT_US }, now_us + ASK_FOR_DARK_US);
    }

    /// The device reported its state while the engine waits for dark.
    pub(super) fn on_darkening(&mut self, state: DeviceState, now_us: u64) {
        let lit = state.light_on || state.exposing.is_some();
        self.notice_state(state);
        if lit {
            self.put_light_off();
        }
        if self.light.must_wait() {
            return;
        }
        if self.next.unconfirmed().is_some() {
            // Whether the layer was seen to shine counts there.
            return self.take_stock(now_us);
        }
        self.light.ended();
        self.advance(now_us);
    }

    pub(super) fn ask_for_dark(&mut self, until_us: u64, now_us: u64) {
        if now_us < until_us {
            self.out.query = true;
            self.deadline = Some(Deadline::at(until_us.min(now_us + ASK_FOR_DARK_US)));
            return;
        }
        if self.device.light_on || self.device.exposing.is_some() {
            let unparked = self.cycle.unparked_text();
            return self.end_unparked(format!("{STAYS_LIT}; {unparked}"));
        }
        self.intent
            .add_end(JobState::Interrupted, "the device did not answer the order to switch its light off".into());
        self.light.give_up();
        self.advance(now_us);
    }
}
