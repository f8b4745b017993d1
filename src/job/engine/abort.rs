//! The abort: light off before anything else, then the machine parks. While the device does not answer, is lit or moves, the abort
//! is sent again, each time in a new session. Tested by `tests/job_engine/abort.rs` and `tests/job_lies/abort.rs`.

use super::ending::URGENT_US;
use super::phase::End;
use super::track::Session;
use super::{Engine, Event, Intent, Phase, SECOND_US};
use crate::device::Light;
use crate::job::{EndOrder, JobState, Limits, Record};
use crate::link::message::{DeviceState, Urgent};

/// Longest wait for a new session after an abort. An aborted device accepts one at once, a restarted one within seconds.
const ABORT_RECONNECT_US: u64 = 10 * SECOND_US;
/// A device is dark 100 ms after an abort; its answer may come before that. If it still reports light after this time, it did not
/// obey. It ignores a repeated frame within the session, so the abort is sent again in a new one. Also the polling interval.
const ABORT_OBEYED_US: u64 = SECOND_US / 2;
/// Sessions in which an abort is tried on a device that does not answer it, or that stays lit or keeps moving.
const MAX_ABORT_SESSIONS: u32 = 5;

impl Engine {
    /// Light off before anything else.
    pub(super) fn abort(&mut self, now_us: u64) {
        self.out.urgent = Some(Urgent::Abort);
        self.abort_order.answered = false;
        self.light.abort();
        if matches!(self.phase, Phase::Ending | Phase::Done) {
            return;
        }
        let is_unbegun = matches!(self.phase, Phase::Checking { .. });
        if is_unbegun && self.line.session == Session::Never && !self.part.is_possible() {
            // No device has an order of this job, so there is no answer to wait for.
            self.intent.replace(JobState::Aborted, "aborted by the operator before it began".into());
            return self.end();
        }
        self.out.forget_session();
        self.uploads.cancel();
        self.act.running = None;
        self.out.journal(Record::Ordered(EndOrder::Abort));
        self.abort_order.sessions = 1;
        let reason = "aborted by the operator".into();
        self.intent = Intent::End(End { state: JobState::Aborted, reason, ordered: Some(EndOrder::Abort) });
        self.await_abort(now_us);
    }

    /// Waits for the answer to the abort sent in this session.
    fn await_abort(&mut self, now_us: u64) {
        self.abort_order.sent_us = now_us;
        self.wait_until(Phase::AbortSent, now_us + ABORT_OBEYED_US);
    }

    /// An event between an abort and the session that follows it.
    pub(super) fn while_aborting(&mut self, event: Event, now_us: u64) {
        match event {
            Event::UrgentDone(Urgent::Abort) => {
                self.abort_order.answered = true;
                self.light.put_off_answered();
                self.light_is_off();
                self.wait_until(Phase::AbortReconnect, now_us + ABORT_RECONNECT_US);
            }
            // Its light may take the rest of the time to go off.
            Event::UrgentFailed(Urgent::Abort) => {
                self.abort_order.answered = true;
                self.light.put_off_answered();
                self.out.notice("the device answered the abort, but says that its light is still on");
                self.out.query = true;
                self.wait_until(Phase::AbortSent, self.abort_order.sent_us + ABORT_OBEYED_US);
            }
            Event::Connected { state, limits } => {
                self.on_connected_after_abort(state, limits, now_us);
            }
            Event::State(state) => self.on_state_after_abort(state, now_us),
            Event::LineLost(_) => self.line.drop_session(),
            Event::Misbehaved(text) => {
                self.line.drop_session();
                self.out.end_session = Some(text);
            }
            Event::Fault(fault) => self.immobile = fault.is_some(),
            Event::Timeout if self.deadline.as_mut().is_some_and(|deadline| deadline.is_over(now_us)) => {
                match self.phase {
                    Phase::AbortSent => self.on_abort_open(now_us),
                    _ => self.end_aborted(),
                }
            }
            _ => {}
        }
    }

    /// The abort is not answered yet: polls for light until the answer is overdue.
    fn on_abort_open(&mut self, now_us: u64) {
        if self.abort_order.answered {
            return self.try_abort_again("the device answered an abort with its light still on", now_us);
        }
        let until_us = self.abort_order.sent_us + URGENT_US;
        if now_us >= until_us {
            return self.wait_until(Phase::AbortReconnect, now_us + ABORT_RECONNECT_US);
        }
        self.out.query = true;
        self.wait_until(Phase::AbortSent, until_us.min(now_us + ABORT_OBEYED_US));
    }

    /// The device reported its state during an abort. While it is lit, it is ordered dark by a LightOff as well. If it had its time
    /// to obey, the abort is sent again in a new session.
    fn on_state_after_abort(&mut self, state: DeviceState, now_us: u64) {
        if !self.line.is_up() {
            return;
        }
        let lit = self.look_for_light(&state, now_us);
        self.notice_state(state);
        if lit && now_us >= self.abort_order.sent_us + ABORT_OBEYED_US {
            self.try_abort_again("the device shows light after an abort", now_us);
        }
    }

    /// Whether the device shows light during an abort. Then it gets a LightOff beside the abort.
    fn look_for_light(&mut self, state: &DeviceState, now_us: u64) -> bool {
        let lit = matches!(self.light.observe(state, now_us), Light::Uncommanded(_));
        if lit {
            self.abort_order.is_dark = false;
            self.out.urgent.get_or_insert(Urgent::LightOff);
        }
        lit
    }

    /// Begins a new session: only there does the device carry out another abort.
    fn try_abort_again(&mut self, why: &str, now_us: u64) {
        self.line.drop_session();
        self.out.new_session = Some(why.to_owned());
        self.wait_until(Phase::AbortReconnect, now_us + ABORT_RECONNECT_US);
    }

    /// A new session began during an abort. Parks the machine if the device has answered, is dark and stands still; else the abort
    /// goes out again.
    fn on_connected_after_abort(&mut self, state: DeviceState, limits: Limits, now_us: u64) {
        let dark = !self.look_for_light(&state, now_us);
        let moving = state.moving;
        self.immobile = state.fault.is_some();
        self.greet(state, limits);
        if self.abort_order.answered && dark {
            self.light_is_off();
        }
        if self.abort_order.answered && dark && !moving {
            return self.park(now_us);
        }
        if self.abort_order.sessions == MAX_ABORT_SESSIONS {
            self.abort_order.is_dark = dark;
            return self.end_aborted();
        }
        self.abort_order.sessions += 1;
        // The link repeats an unanswered abort by itself.
        if self.abort_order.answered {
            self.out.urgent = Some(Urgent::Abort);
            self.abort_order.answered = false;
        }
        self.out.query = true;
        self.await_abort(now_us);
    }

    fn light_is_off(&mut self) {
        if !self.abort_order.is_dark {
            self.abort_order.is_dark = true;
            self.out.journal(Record::LightOff);
        }
    }

    /// The device did not come to rest after an abort.
    fn end_aborted(&mut self) {
        let unparked = self.cycle.unparked_text();
        let text = match (self.abort_order.is_dark, self.line.is_up()) {
            (false, _) => format!(
                "WARNING: the device did not confirm that its light is off, and {unparked}: switch the machine off at its \
                 mains and look"
            ),
            (true, false) => format!("the light is off, but the device did not come back: {unparked}"),
            (true, true) if self.device.moving => {
                format!("the light is off, but the device does not stop moving: {unparked}")
            }
            (true, true) => format!("the light is off, but the device does not answer: {unparked}"),
        };
        self.intent.add_end(JobState::Aborted, text);
        self.end();
    }
}
