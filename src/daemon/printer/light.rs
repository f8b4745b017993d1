//! The device while no job runs: its state is queried, and light that was not commanded is switched off.
//! `tests/interrupted.rs` and `tests/hostile/light.rs` test it.

use super::Printer;
use crate::device::{DriverEvent, Light, LightWatch, STAYS_LIT};
use crate::link::message::{DeviceState, Urgent};

impl Printer {
    /// Handles a state of the device while no job runs.
    pub(crate) fn idle_state(&mut self, state: &DeviceState, now_us: u64) {
        self.look_at_doubt(state);
        self.watch_light(state, now_us);
    }

    fn watch_light(&mut self, state: &DeviceState, now_us: u64) {
        let commanded = state.exposing.and_then(|id| Some((id, self.jobs.commanded_ms(id, state.boot_id)?)));
        if let Some((id, duration_ms)) = commanded {
            self.idle.light.found(id, duration_ms, now_us);
        }
        self.idle.light_due_us = None;
        match self.idle.light.observe(state, now_us) {
            // The watch still knows an exposure whose end is unconfirmed; the job's engine needs that.
            Light::Dark if self.open_exposure().is_some_and(|(_, id, _)| self.idle.light.has_shone(id)) => {}
            Light::Dark => self.idle.light.ended(),
            Light::Commanded { until_us } => self.idle.light_due_us = Some(until_us + 1),
            Light::Uncommanded(text) => self.put_light_off(&text),
        }
    }

    /// The watch on the device's light, of the running job or of [`Idle`].
    fn light(&self) -> &LightWatch {
        self.running.as_ref().map_or(&self.idle.light, |running| running.engine.light())
    }

    /// Notes whether the device stays lit although it was told to go dark. The operator gets one notice; status and device views
    /// say so as long as it lasts.
    pub(crate) fn look_at_light(&mut self) {
        let stays_lit = self.light().stays_lit();
        match (stays_lit, self.device.stays_lit.is_some()) {
            (true, false) => {
                self.device.stays_lit = Some(STAYS_LIT.into());
                self.notice(STAYS_LIT.into());
            }
            (false, true) => {
                self.device.stays_lit = None;
                self.tell("the device reports that its light is off".into());
            }
            _ => {}
        }
    }

    /// The device shows light that was not commanded: why no job may begin to print. `None` if it does not.
    pub(crate) fn unwanted_light(&self) -> Option<&'static str> {
        let light = self.light();
        match (light.stays_lit(), light.is_unwanted()) {
            (true, _) => Some(STAYS_LIT),
            (false, true) => Some("the device shows light that no job commanded, and was told to switch it off"),
            (false, false) => None,
        }
    }

    fn put_light_off(&mut self, text: &str) {
        if !self.idle.light.must_wait() {
            self.notice(format!("{text}; it was told to switch its light off"));
        }
        self.idle.light.put_off();
        self.send_urgent(Urgent::LightOff);
    }

    /// Handles a deadline while no job runs: an exposure or the raising of the plate is overdue.
    pub(crate) fn idle_timeout(&mut self, now_us: u64) {
        if self.idle.light_due_us.take_if(|due_us| *due_us <= now_us).is_some()
            && let Some(text) = self.idle.light.overdue()
        {
            self.put_light_off(&text);
        }
        self.raise_timeout(now_us);
    }

    /// Handles an event of the driver while no job runs.
    pub(crate) fn idle_event(&mut self, event: DriverEvent, now_us: u64) {
        match event {
            DriverEvent::StateKnown { state, .. } => self.idle_state(&state, now_us),
            DriverEvent::ActDone(outcome) => self.raise_ended(outcome),
            DriverEvent::Misbehaved(text) => self.end_session(text, now_us),
            _ => {}
        }
    }
}
