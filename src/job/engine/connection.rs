//! Sessions with the device: begun, lost, ended for an error, not coming back. Tested by `tests/job_lies/answers.rs`.

use super::track::Session;
use super::{Engine, Phase, RECONNECT_US, SECOND_US};
use crate::job::{JobState, Limits, Record};
use crate::link::message::DeviceState;

/// Lost lines in a row, without a layer printed in between, that are tolerated.
const MAX_LOSSES: u32 = 20;
/// Protocol errors in a row, without a layer printed in between, that end the job.
const MAX_MISBEHAVIOURS: u32 = 3;
/// Printed layers that make up for one protocol error. Each error costs a session and some seconds, during which a layer waits
/// longer than the others. One error an hour is acceptable; one per layer makes bad parts.
const LAYERS_PER_MISBEHAVIOUR: u32 = 50;
/// Protocol errors, not yet made up for, that are tolerated. A few in a row are chance; more show a faulty device.
const MAX_MISBEHAVIOURS_OPEN: u32 = 8;

impl Engine {
    /// A session with the device began.
    pub(super) fn on_connected(&mut self, state: DeviceState, limits: Limits, now_us: u64) {
        if self.line.is_up() {
            // The end of the old session was not reported.
            self.on_line_lost("the device began a new session".into(), now_us);
        }
        self.greet(state, limits);
        match self.phase {
            Phase::Checking { ready: true } => self.start(now_us),
            Phase::Lost => self.take_stock(now_us),
            _ => {}
        }
    }

    /// Takes over the state of a new session.
    pub(super) fn greet(&mut self, state: DeviceState, limits: Limits) {
        self.line.session = Session::Up;
        self.cycle.greeted(limits);
        self.uploads.reset(&self.plan, &state, |exposure| self.cycle.knows(exposure));
        self.light.greeted(&state);
        self.notice_state(state);
    }

    /// The connected device is another machine, or cannot print the recipe.
    pub(super) fn on_unfit(&mut self, text: String, now_us: u64) {
        match self.phase {
            Phase::Checking { .. } => self.end_unbegun(&text),
            // The machine is parked.
            Phase::Resting => self.wind_down(JobState::Interrupted, text, now_us),
            // Nothing is commanded of a foreign device, not even to park.
            _ if self.part.is_possible() => {
                let unparked = self.cycle.unparked_text();
                self.end_unparked(format!("{text}; {unparked}"));
            }
            _ => self.end_unparked(text),
        }
    }

    /// Begins the job: the preflight has passed, and the device is there.
    pub(super) fn start(&mut self, now_us: u64) {
        if let Err(text) = self.cycle.check_fit(self.plan.passes.layer_count()) {
            return self.end_unbegun(&text);
        }
        if self.device.slots.is_empty() {
            return self.end_unbegun("the device says it has no layer slots; it cannot print. Check its firmware");
        }
        if let Some(text) = self.cycle.notice() {
            self.out.notice(text);
        }
        self.out.journal(Record::Started { exposure: self.next.number });
        self.take_stock(now_us);
    }

    /// The session is lost.
    pub(super) fn on_line_lost(&mut self, reason: String, now_us: u64) {
        self.line.drop_session();
        self.line.loss = reason;
        self.act.running = None;
        self.out.forget_session();
        self.uploads.cancel();
        if !matches!(self.phase, Phase::Checking { .. } | Phase::Resting | Phase::Lost) {
            self.lose(now_us);
        }
    }

    /// The device broke the protocol. A new session may help; repeated errors end the job.
    pub(super) fn on_misbehaved(&mut self, text: &str, now_us: u64) {
        self.failures.misbehaviours_in_a_row += 1;
        self.failures.layers_of_misbehaviour += LAYERS_PER_MISBEHAVIOUR;
        if self.failures.misbehaviours_in_a_row > MAX_MISBEHAVIOURS {
            // Nothing more is commanded, not even to park.
            let unparked = self.cycle.unparked_text();
            return self.end_unparked(format!("{text}; {unparked}"));
        }
        if self.failures.misbehaviours_in_a_row == MAX_MISBEHAVIOURS {
            let reason = format!("{text} ({MAX_MISBEHAVIOURS} times without a layer printed in between)");
            self.intent.add_end(self.failed_or_interrupted(), reason);
        } else if self.failures.layers_of_misbehaviour > MAX_MISBEHAVIOURS_OPEN * LAYERS_PER_MISBEHAVIOUR {
            let reason = format!(
                "{text} (it has broken the protocol more than {MAX_MISBEHAVIOURS_OPEN} times, more often than once in \
                 {LAYERS_PER_MISBEHAVIOUR} layers)"
            );
            self.intent.add_end(self.failed_or_interrupted(), reason);
        }
        self.end_session(text, now_us);
        if self.phase == Phase::Resting {
            // Nothing that a paused job waits for would end it.
            self.reconsider(true, now_us);
        }
    }

    /// Ends the session and waits for a new one, whose welcome reports the device's state.
    pub(super) fn end_session(&mut self, why: &str, now_us: u64) {
        self.on_line_lost(why.to_owned(), now_us);
        if !matches!(self.phase, Phase::Ending | Phase::Done) {
            self.out.end_session = Some(why.to_owned());
        }
    }

    /// Waits for a new session. Nothing is commanded until then.
    pub(super) fn lose(&mut self, now_us: u64) {
        self.pace.break_off();
        self.failures.losses_in_a_row += 1;
        if self.failures.losses_in_a_row > MAX_LOSSES {
            let text = format!(
                "the line was lost {MAX_LOSSES} times without one layer printed in between ({}): check cable and device, \
                 then resume",
                self.line.loss
            );
            return self.end_unparked(text);
        }
        self.out.notice(format!(
            "the session with the device is lost ({}); the job waits, dark, for a new one",
            self.line.loss
        ));
        self.wait_until(Phase::Lost, now_us + RECONNECT_US);
    }

    /// No session began in time.
    pub(super) fn on_no_device(&mut self) {
        let why = if self.line.loss.is_empty() { "no answer" } else { self.line.loss.as_str() };
        let (seconds, remedy) =
            (RECONNECT_US / SECOND_US, "check its power and cable and the machine file's link.path");
        if self.line.session == Session::Never {
            return self.end_unbegun(&format!("no device was there within {seconds} s ({why}): {remedy}"));
        }
        let unparked = self.cycle.unparked_text();
        self.end_unparked(format!("the device did not come back within {seconds} s ({why}): {remedy}; {unparked}"));
    }
}
