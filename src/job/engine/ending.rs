//! Every way out of printing: pause, stop, failure, fault, shutdown, abort.

use super::disk::WAITS_FOR_DISK;
use super::{Engine, Event, Intent, Phase, SECOND_US};
use crate::device::Light;
use crate::job::{EndOrder, JobState, Record};
use crate::link::message::{DeviceState, Fault, Refusal, Urgent};
use crate::text::plain_line;

/// At shutdown, an exposure that ends within this time is not cut short: a layer cut short is in doubt. Half a minute covers the
/// longest usual bottom exposure; systemd waits for two minutes.
const SHUTDOWN_EXPOSURE_US: u64 = 30 * SECOND_US;
/// Longest wait for the answer to an urgent order. A device answers within 100 ms; the rest is for the recovery of the line.
pub(super) const URGENT_US: u64 = 5 * SECOND_US;
/// Longest wait for a new session after an abort. An aborted device accepts one at once, a restarted one within seconds.
const ABORT_RECONNECT_US: u64 = 10 * SECOND_US;
/// A device is dark 100 ms after an abort; its answer may come before that. If it still reports light after this time, it did not
/// obey. It ignores a repeated frame within the session, so the abort is sent again in a new one. Also the polling interval.
const ABORT_OBEYED_US: u64 = SECOND_US / 2;
/// Sessions in which an abort is tried on a device that does not answer it, or that stays lit or keeps moving.
const MAX_ABORT_SESSIONS: u32 = 5;

impl Engine {
    /// Ends the job after the step under way.
    pub(super) fn wind_down(&mut self, state: JobState, reason: String, now_us: u64) {
        self.intend_to_end(state, reason);
        self.reconsider(matches!(state, JobState::Interrupted | JobState::Failed), now_us);
    }

    /// After a change of intent: ends waits that are no longer needed. Acts under way run to their end. With `at_once`, acts that
    /// were not handed out yet are withdrawn.
    pub(super) fn reconsider(&mut self, at_once: bool, now_us: u64) {
        if !matches!(self.intent, Intent::End(..)) {
            return match self.phase {
                Phase::Settling | Phase::WarmingUp | Phase::Waiting { .. } | Phase::Dripping => self.advance(now_us),
                _ => {}
            };
        }
        match self.phase {
            // A part may be in the vat: wait for the device, to lift it.
            Phase::Checking if self.touched && !at_once => {}
            Phase::Checking | Phase::Resting => self.end(),
            Phase::Settling | Phase::WarmingUp | Phase::Waiting { .. } | Phase::Dripping => self.advance(now_us),
            Phase::Commanding if at_once => self.withdraw(now_us),
            Phase::Exposing { .. } if at_once && self.out.act.is_some() => self.withdraw(now_us),
            _ => {}
        }
    }

    /// Withdraws an act that was not handed out yet.
    pub(super) fn withdraw(&mut self, now_us: u64) {
        self.out.act = None;
        self.act.running = None;
        self.light.ended();
        if self.unconfirmed.take().is_some() {
            self.out.journal(Record::Withdrawn { layer: self.next_layer });
        }
        self.advance(now_us);
    }

    /// Position at which the plate is clear of the resin, micrometres.
    pub(super) fn parking_um(&self) -> i32 {
        self.plan.parked_position_um(self.next_layer).min(self.max_position_um)
    }

    /// Lifts the plate clear of the resin.
    pub(super) fn park(&mut self, now_us: u64) {
        let target_um = self.parking_um();
        match self.position_um {
            Some(position_um) if position_um < target_um && !self.immobile => {
                self.start_move(target_um, self.plan.recipe.lift_speed_um_s, Phase::Parking, now_us);
            }
            Some(position_um) if position_um >= target_um => self.parked(now_us),
            Some(_) => self.unparked("the device has a fault", now_us),
            None => self.unparked("the device does not know where it is", now_us),
        }
    }

    /// The plate cannot be lifted. The operator must know if a part may hang on it, or the job was aborted.
    pub(super) fn unparked(&mut self, why: &str, now_us: u64) {
        if self.touched || self.aborting {
            let text = format!("the plate was not lifted: {why}");
            match self.intent.clone() {
                Intent::End(state, _) => self.intend_to_end(state, text),
                Intent::Print | Intent::Pause => self.out.notice(text),
            }
        }
        self.rest(now_us);
    }

    pub(super) fn parked(&mut self, now_us: u64) {
        self.lifted = true;
        self.rest(now_us);
    }

    fn rest(&mut self, now_us: u64) {
        if self.intent != Intent::Pause {
            return self.end();
        }
        self.out.journal(Record::Paused);
        self.pace.break_off();
        self.phase = Phase::Resting;
        self.deadline = None;
        if self.out.journal_broken {
            self.advance(now_us);
        }
    }

    /// Ends the job as intended. Nothing more is commanded.
    fn end(&mut self) {
        self.out.forget_session();
        self.uploads.cancel();
        self.act.running = None;
        self.deadline = None;
        self.phase = Phase::Ending;
        // A part left in the vat keeps the machine, unless the job was aborted.
        if let Intent::End(state @ JobState::Stopped, _) = &mut self.intent
            && self.touched
            && !self.lifted
        {
            *state = JobState::Interrupted;
        }
        if self.touched && self.lifted {
            self.out.journal(Record::Parked);
        }
        if let Intent::End(state, _) = self.intent {
            self.out.journal(Record::Ended { state, reason: self.end_reason() });
        }
    }

    pub(super) fn finish(&mut self) {
        self.phase = Phase::Done;
        if let Intent::End(state, _) = self.intent {
            self.out.finished = Some((state, self.end_reason()));
        }
    }

    /// Ends a job before it commanded anything. A part in the vat keeps the machine, whatever was ordered.
    pub(super) fn end_unbegun(&mut self, text: &str) {
        self.intent = if self.touched {
            Intent::End(JobState::Interrupted, format!("{text}; the plate was not lifted"))
        } else {
            Intent::End(JobState::Failed, text.into())
        };
        self.end();
    }

    /// Ends the job without moving the plate.
    pub(super) fn end_unparked(&mut self, text: String) {
        self.intend_to_end(JobState::Interrupted, text);
        self.end();
    }

    /// End state of a job that cannot go on: failed without light, else interrupted, so that it can be resumed.
    pub(super) fn failed_or_interrupted(&self) -> JobState {
        if self.touched { JobState::Interrupted } else { JobState::Failed }
    }

    /// It is unknown how much light the commanded layer had.
    pub(super) fn doubt(&mut self, why: &str, now_us: u64) {
        if self.in_doubt.is_none() {
            self.out.journal(Record::InDoubt { layer: self.next_layer, why: why.to_owned() });
        }
        self.unconfirmed = None;
        self.in_doubt = Some(why.to_owned());
        self.intend_to_end(JobState::Interrupted, String::new());
        self.advance(now_us);
    }

    /// Why the job ends, and what to do.
    pub(super) fn end_reason(&self) -> String {
        let Intent::End(_, reason) = &self.intent else { return String::new() };
        let layer = self.next_layer;
        let doubt = self.in_doubt.as_ref().map(|why| format!("layer {layer} is in doubt: {why}{DECIDE}"));
        let texts: Vec<_> =
            doubt.iter().chain(Some(reason).filter(|reason| !reason.is_empty())).map(String::as_str).collect();
        let text = texts.join("; ");
        if self.ordered { text.replace(DECIDE, "").replace(THEN_RESUME, "") } else { text }
    }

    /// What an ending job waits for if the device or the disk does not answer; else empty.
    pub(super) fn wait_before_end(&self) -> String {
        match self.phase {
            // A device that took the abort is dark until the new session begins.
            Phase::AbortSent if !self.line_up && !self.light_known_off => ABORT_WAITS.into(),
            Phase::AbortReconnect if !self.light_known_off => ABORT_WAITS.into(),
            Phase::Lost => format!("waiting for the device: {}", self.loss),
            Phase::Checking if !self.line_up => "waiting for the device".into(),
            Phase::Commanding | Phase::Confirming | Phase::Ending if self.disk.is_slow() => WAITS_FOR_DISK.into(),
            _ => String::new(),
        }
    }

    /// Ends a running exposure early.
    pub(super) fn cut_short(&mut self, now_us: u64) {
        self.put_light_off();
        self.wait_until(Phase::CuttingShort, now_us + URGENT_US);
    }

    pub(super) fn shutdown(&mut self, now_us: u64) {
        const STOPPED: &str = "the daemon was stopped: `layerctl resume` goes on, `layerctl abort` ends the job";
        match self.phase {
            Phase::Checking if self.touched => return self.end_unbegun(STOPPED),
            // It ends as aborted: the plate lifts, or the engine waits for the line, a minute at most.
            _ if self.aborting => {}
            _ => self.wind_down(JobState::Interrupted, STOPPED.into(), now_us),
        }
        match &mut self.phase {
            Phase::Lost | Phase::Homing if !self.aborting => self.end(),
            Phase::Asking { until_us } => *until_us = (*until_us).min(now_us + SHUTDOWN_EXPOSURE_US),
            Phase::Exposing { light_until_us } if *light_until_us > now_us + SHUTDOWN_EXPOSURE_US => {
                self.cut_short(now_us);
            }
            _ => {}
        }
    }

    pub(super) fn on_fault(&mut self, fault: Option<&Fault>, now_us: u64) {
        let Some(fault) = fault else {
            self.immobile = false;
            return self.out.notice("the device reports that its fault is gone");
        };
        self.immobile = true;
        self.wind_down(JobState::Interrupted, fault_text(fault), now_us);
        if self.act.running.is_some() {
            // The device has switched its light off; it must still report the outcome.
            if let Some(deadline) = &mut self.deadline {
                deadline.no_later_than(now_us + URGENT_US);
            }
        }
    }

    pub(super) fn on_fault_at_rest(&mut self, fault: &Fault, now_us: u64) {
        self.immobile = true;
        self.wind_down_at_rest(JobState::Interrupted, fault_text(fault), now_us);
    }

    pub(super) fn on_refused(&mut self, refusal: Refusal, now_us: u64) {
        let layer = self.next_layer;
        if !matches!(self.phase, Phase::Exposing { .. } | Phase::CuttingShort) {
            return self.end_unparked(format!("the device refused to move: {}", remedy(refusal)));
        }
        match refusal {
            Refusal::CutShort if self.light.must_wait() => self.doubt("its light was switched off", now_us),
            Refusal::CutShort => {
                self.doubt("the device ended its light early (`layerctl device` tells after how long)", now_us);
            }
            // Its state must agree that there was no light.
            _ => {
                if refusal == Refusal::AlreadyExposed {
                    self.out
                        .notice(format!("the device says it exposed layer {layer} before; asking it for its state"));
                }
                self.refused = Some(refusal);
                self.ask(now_us);
            }
        }
    }

    /// The device refused to expose the layer, and nothing shows that there was light.
    pub(super) fn on_refused_unlit(&mut self, refusal: Refusal, now_us: u64) {
        let layer = self.next_layer;
        match refusal {
            Refusal::AlreadyExposed => {
                self.deny();
                self.advance(now_us);
            }
            Refusal::NoSuchLayer => {
                self.out.notice(format!("the device no longer holds layer {layer}; it is sent again"));
                self.deny();
                self.uploads.release(layer);
                self.advance(now_us);
            }
            _ => {
                self.deny();
                let state = if refusal == Refusal::NotReady { JobState::Interrupted } else { JobState::Failed };
                let text = format!("the device refused to expose layer {layer}: {}", remedy(refusal));
                self.wind_down_at_rest(state, text, now_us);
            }
        }
    }

    pub(super) fn on_journal_failed(&mut self, text: &str, now_us: u64) {
        self.out.journal_failed();
        if self.phase == Phase::Ending {
            return self.finish();
        }
        let reason = format!("the journal cannot be written: {text}. Fix that, then resume");
        self.intend_to_end(JobState::Interrupted, reason);
        match self.phase {
            Phase::Commanding => {
                self.unconfirmed = None;
                self.advance(now_us);
            }
            Phase::Confirming => self.advance(now_us),
            _ => self.reconsider(true, now_us),
        }
    }

    /// Light off before anything else.
    pub(super) fn abort(&mut self, now_us: u64) {
        self.out.urgent = Some(Urgent::Abort);
        self.abort_order.answered = false;
        self.light.abort();
        if matches!(self.phase, Phase::Ending | Phase::Done) {
            return;
        }
        if self.phase == Phase::Checking && !self.ever_connected && !self.touched {
            // No device has an order of this job, so there is no answer to wait for.
            self.intent = Intent::End(JobState::Aborted, "aborted by the operator before it began".into());
            return self.end();
        }
        self.out.forget_session();
        self.uploads.cancel();
        self.act.running = None;
        (self.aborting, self.ordered) = (true, true);
        self.out.journal(Record::Ordered(EndOrder::Abort));
        self.abort_order.sessions = 1;
        self.intent = Intent::End(JobState::Aborted, "aborted by the operator".into());
        self.await_abort(now_us);
    }

    /// Waits for the answer to the abort sent in this session.
    fn await_abort(&mut self, now_us: u64) {
        self.abort_order.sent_us = now_us;
        self.wait_until(Phase::AbortSent, now_us + ABORT_OBEYED_US);
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
        if !self.line_up {
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
            self.light_known_off = false;
            self.out.urgent.get_or_insert(Urgent::LightOff);
        }
        lit
    }

    /// Begins a new session: only there does the device carry out another abort.
    fn try_abort_again(&mut self, why: &str, now_us: u64) {
        self.line_up = false;
        self.out.new_session = Some(why.to_owned());
        self.wait_until(Phase::AbortReconnect, now_us + ABORT_RECONNECT_US);
    }

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
            Event::Connected { state, max_position_um } => {
                self.on_connected_after_abort(state, max_position_um, now_us);
            }
            Event::State(state) => self.on_state_after_abort(state, now_us),
            Event::LineLost(_) => self.line_up = false,
            Event::Misbehaved(text) => {
                self.line_up = false;
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

    /// A new session began during an abort. Lifts the plate if the device has answered, is dark and stands still; else the abort goes
    /// out again.
    fn on_connected_after_abort(&mut self, state: DeviceState, max_position_um: i32, now_us: u64) {
        let dark = !self.look_for_light(&state, now_us);
        let moving = state.moving;
        self.immobile = state.fault.is_some();
        self.greet(state, max_position_um);
        if self.abort_order.answered && dark {
            self.light_is_off();
        }
        if self.abort_order.answered && dark && !moving {
            return self.park(now_us);
        }
        if self.abort_order.sessions == MAX_ABORT_SESSIONS {
            self.light_known_off = dark;
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
        if !self.light_known_off {
            self.light_known_off = true;
            self.out.journal(Record::LightOff);
        }
    }

    /// The device did not come to rest after an abort.
    fn end_aborted(&mut self) {
        let text = match (self.light_known_off, self.line_up) {
            (false, _) => LIGHT_UNKNOWN,
            (true, false) => "the light is off, but the device did not come back: the plate was not lifted",
            (true, true) if self.device.moving => {
                "the light is off, but the device does not stop moving: the plate was not lifted"
            }
            (true, true) => "the light is off, but the device does not answer: the plate was not lifted",
        };
        self.intend_to_end(JobState::Aborted, text.into());
        self.end();
    }
}

/// Advice for a layer in doubt. Both texts are left out for a job that cannot be resumed.
const DECIDE: &str = ". Look at the part, then resume with `--in-doubt exposed` or `--in-doubt repeat`";
const THEN_RESUME: &str = ", then resume";
const ABORT_WAITS: &str = "waiting for the device, which does not answer: if there is light or the plate moves, switch the printer off \
     at the mains";
const LIGHT_UNKNOWN: &str = "WARNING: the device did not confirm that its light is off, and the plate was not lifted: switch the \
     machine off at its mains and look";

fn fault_text(fault: &Fault) -> String {
    format!("the device reports fault {} ({}): clear it, then resume", fault.code, plain_line(&fault.text))
}

fn remedy(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::NotReady => "it is not ready; look at the device, then resume",
        Refusal::AlreadyExposed => "it exposed that layer before",
        Refusal::BadDuration => {
            "the exposure is longer than it allows; lower exposure_ms and bottom_exposure_ms in the recipe"
        }
        Refusal::NoSuchLayer => "it does not hold that layer",
        Refusal::SlotBusy | Refusal::Busy => "it is busy with something this job did not ask for; check its firmware",
        Refusal::BadLayer => "the layer did not arrive whole; check the line",
        Refusal::BadEncoding => "it does not know the encoding; check its firmware",
        Refusal::BadMove => {
            "the position is outside its travel, or the speed is; check lift_speed_um_s, retract_speed_um_s and the part's height"
        }
        Refusal::NotHomed => "it does not know where its plate is; take the part off and start anew",
        Refusal::CutShort => "it was ended early by an interlock or at the machine; look at the device, then resume",
        Refusal::Unknown => "it does not know the request; check that it is a DLP machine of this protocol version",
    }
}
