//! Finding out what the device did: at the start, after a lost line, after a crash of the host.

use super::{
    Engine, Intent, LAYERS_PER_MISBEHAVIOUR, MAX_MISBEHAVIOURS, MAX_MISBEHAVIOURS_OPEN, Phase, RECONNECT_US, SECOND_US,
};
use crate::deadline::Deadline;
use crate::device::Light;
use crate::job::{Fate, JobState, Record, ResumeChoice, fate};
use crate::link::message::{DeviceState, ExposureId, Refusal};
use crate::text::mm_text;

/// Polling interval while the device still moves or exposes.
const ASK_EVERY_US: u64 = SECOND_US / 2;
/// Longest wait for the device to come to rest: the longest exposure of a recipe (ten minutes) and a margin.
const ASK_LIMIT_US: u64 = 620 * SECOND_US;
/// Lost lines in a row, without a layer printed in between, that are tolerated.
const MAX_LOSSES: u32 = 20;

/// No further reason is added to one longer than this: journal records are limited in size.
const MAX_REASON_BYTES: usize = 1000;

const WENT_BACK_REMEDY: &str = "look at the device and the part, then resume";

impl Engine {
    pub(super) fn on_connected(&mut self, state: DeviceState, max_position_um: i32, now_us: u64) {
        if self.line_up {
            // The end of the old session was not reported.
            self.on_line_lost("the device began a new session".into(), now_us);
        }
        self.greet(state, max_position_um);
        match self.phase {
            Phase::Checking if self.ready => self.begin(now_us),
            Phase::Lost => self.take_stock(now_us),
            _ => {}
        }
    }

    /// Takes over the state of a new session.
    pub(super) fn greet(&mut self, state: DeviceState, max_position_um: i32) {
        self.line_up = true;
        self.ever_connected = true;
        self.max_position_um = max_position_um;
        self.uploads.reset(self.plan.key, &state);
        self.warm = false;
        self.light.greeted(&state);
        self.notice_state(state);
    }

    /// Checks that the layer reported as exposed last never goes back.
    fn compare_exposed(&mut self, state: &DeviceState) {
        let Some(told) = state.last_exposed.filter(|id| id.job == self.plan.key).map(|id| id.layer) else { return };
        let before = *self.told_exposed.get_or_insert(told);
        self.told_exposed = Some(before.max(told));
        if told < before && self.went_back.is_none() {
            self.went_back = Some(format!(
                "the device named layer {before} of this job as exposed last, and now it names layer {told}: it was reset, or what \
                 it says is wrong"
            ));
        }
    }

    /// The connected device is another machine, or cannot print the recipe.
    pub(super) fn on_unfit(&mut self, text: String, now_us: u64) {
        match self.phase {
            Phase::Checking => self.end_unbegun(&text),
            // The plate is clear.
            Phase::Resting => self.wind_down(JobState::Interrupted, text, now_us),
            // Nothing is commanded of a foreign device, not even the lift.
            _ if self.touched => self.end_unparked(format!("{text}; the plate was not lifted")),
            _ => self.end_unparked(text),
        }
    }

    pub(super) fn notice_state(&mut self, state: DeviceState) {
        self.compare_exposed(&state);
        self.position_um = state.position_um;
        self.device = state;
    }

    pub(super) fn begin(&mut self, now_us: u64) {
        let height_um = f64::from(self.plan.layer_count) * self.plan.recipe.layer_height_um;
        if height_um > f64::from(self.max_position_um) {
            let text = format!(
                "the part needs the plate {} above the vat, the device goes up to {}: choose a lower part",
                mm_text(height_um),
                mm_text(self.max_position_um)
            );
            return self.end_unbegun(&text);
        }
        if self.device.slots.is_empty() {
            return self.end_unbegun("the device says it has no layer slots; it cannot print. Check its firmware");
        }
        if self.plan.clear_height_um > f64::from(self.max_position_um) {
            self.out.notice(format!(
                "the plate cannot lift to the machine's clear height of {}: the device goes up to {}, and it rests there",
                mm_text(self.plan.clear_height_um),
                mm_text(self.max_position_um)
            ));
        }
        self.out.journal(Record::Started { layer: self.next_layer });
        self.take_stock(now_us);
    }

    pub(super) fn on_line_lost(&mut self, reason: String, now_us: u64) {
        self.line_up = false;
        self.act.running = None;
        self.out.forget_session();
        self.uploads.cancel();
        self.loss = reason;
        if !matches!(self.phase, Phase::Checking | Phase::Resting | Phase::Lost) {
            self.lose(now_us);
        }
    }

    /// The device broke the protocol. A new session may help; repeated errors end the job.
    pub(super) fn on_misbehaved(&mut self, text: &str, now_us: u64) {
        self.failures.misbehaviours_in_a_row += 1;
        self.failures.layers_of_misbehaviour += LAYERS_PER_MISBEHAVIOUR;
        if self.failures.misbehaviours_in_a_row > MAX_MISBEHAVIOURS {
            // Not even the lift is commanded.
            return self.end_unparked(format!("{text}; the plate was not lifted"));
        }
        if self.failures.misbehaviours_in_a_row == MAX_MISBEHAVIOURS {
            let reason = format!("{text} ({MAX_MISBEHAVIOURS} times without a layer printed in between)");
            self.intend_to_end(self.failed_or_interrupted(), reason);
        } else if self.failures.layers_of_misbehaviour > MAX_MISBEHAVIOURS_OPEN * LAYERS_PER_MISBEHAVIOUR {
            let reason = format!(
                "{text} (it has broken the protocol more than {MAX_MISBEHAVIOURS_OPEN} times, more often than once in \
                 {LAYERS_PER_MISBEHAVIOUR} layers)"
            );
            self.intend_to_end(self.failed_or_interrupted(), reason);
        }
        self.end_session(text, now_us);
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
                self.loss
            );
            return self.end_unparked(text);
        }
        self.out
            .notice(format!("the session with the device is lost ({}); the job waits, dark, for a new one", self.loss));
        self.wait_until(Phase::Lost, now_us + RECONNECT_US);
    }

    pub(super) fn on_no_device(&mut self) {
        let why = if self.loss.is_empty() { "no answer" } else { self.loss.as_str() };
        let (seconds, remedy) =
            (RECONNECT_US / SECOND_US, "check its power and cable and the machine file's link.path");
        if !self.ever_connected {
            return self.end_unbegun(&format!("no device was there within {seconds} s ({why}): {remedy}"));
        }
        self.end_unparked(format!(
            "the device did not come back within {seconds} s ({why}): {remedy}; the plate was not lifted"
        ));
    }

    /// The device reported its state. In every phase its light is compared with what was commanded.
    pub(super) fn on_state(&mut self, state: DeviceState, now_us: u64) {
        if !self.line_up {
            return;
        }
        let light = self.light.observe(&state, now_us);
        self.look_for_early_end(&state, now_us);
        let knew = self.went_back.is_some();
        self.compare_exposed(&state);
        let waits = matches!(self.phase, Phase::Checking | Phase::Asking { .. } | Phase::Darkening { .. });
        if let Some(text) = self.went_back.as_ref().filter(|_| !knew && !waits) {
            self.wind_down(JobState::Interrupted, format!("{text}: {WENT_BACK_REMEDY}"), now_us);
        }
        match (self.phase, light) {
            (_, Light::Uncommanded(text)) => {
                self.notice_state(state);
                self.on_uncommanded_light(&text, now_us);
            }
            (Phase::Asking { .. }, _) => {
                self.notice_state(state);
                self.take_stock(now_us);
            }
            (Phase::Darkening { .. }, _) => self.on_darkening(state, now_us),
            // The light-off overtook the exposure on the line.
            (Phase::CuttingShort, Light::Commanded { .. }) if !self.light.awaits_answer() => self.put_light_off(),
            _ => self.watch_plate(state.position_um, now_us),
        }
    }

    /// Asks for the state at once, then polls until the device is at rest.
    pub(super) fn ask(&mut self, now_us: u64) {
        self.out.query = true;
        let until_us = now_us + ASK_LIMIT_US;
        self.wait_until(Phase::Asking { until_us }, now_us + ASK_EVERY_US);
    }

    pub(super) fn ask_again(&mut self, until_us: u64, now_us: u64) {
        if now_us >= until_us {
            return self.end_unparked("the device did not come to rest in time: check it, then resume".into());
        }
        self.out.query = true;
        self.deadline = Some(Deadline::at(now_us + ASK_EVERY_US));
    }

    /// Decides from the device's state how to go on. The host has nothing under way.
    pub(super) fn take_stock(&mut self, now_us: u64) {
        let state = self.device.clone();
        if let Some(commanded) = self.unconfirmed.filter(|commanded| commanded.boot_id == state.boot_id) {
            let id = ExposureId::first_pass(self.plan.key, commanded.layer);
            if state.exposing == Some(id) {
                self.light.found(id, self.plan.recipe.layer_exposure_ms(commanded.layer), now_us);
            }
        }
        let busy_until_us = match self.light.observe(&state, now_us) {
            Light::Uncommanded(text) => return self.on_uncommanded_light(&text, now_us),
            Light::Commanded { until_us } => Some(until_us + 1),
            Light::Dark => state.moving.then_some(now_us + ASK_LIMIT_US),
        };
        if let Some(fault) = state.fault {
            return self.on_fault_at_rest(&fault, now_us);
        }
        match busy_until_us {
            Some(busy_until_us) => self.poll(busy_until_us, now_us),
            None => self.take_stock_at_rest(now_us),
        }
    }

    /// Waits for a device that still moves or exposes: the timer asks for its state again.
    fn poll(&mut self, busy_until_us: u64, now_us: u64) {
        let until_us = match self.phase {
            Phase::Asking { until_us } => until_us,
            _ => now_us + ASK_LIMIT_US,
        };
        let next_us = until_us.min(busy_until_us).min(now_us + ASK_EVERY_US);
        self.wait_until(Phase::Asking { until_us }, next_us);
    }

    /// The device is dark and stands still: compares what it exposed with the journal.
    fn take_stock_at_rest(&mut self, now_us: u64) {
        if self.aborting {
            return self.advance(now_us);
        }
        if self.confirmed && self.device.last_exposed.is_some_and(|id| id.job != self.plan.key) {
            let text = "the device has exposed layers of another job since: this job's part is no longer where it was. Abort it";
            return self.end_unparked(text.into());
        }
        if let Some(text) = &self.went_back {
            let text = format!("{text}: {WENT_BACK_REMEDY}");
            self.intend_to_end(JobState::Interrupted, text);
        }
        let shone = self.light.has_shone(self.exposure_id());
        self.light.ended();
        // The operator's choice is for this layer as it is now, not for a later one.
        let choice = std::mem::take(&mut self.choice);
        if self.unconfirmed.is_some() || self.in_doubt.is_some() {
            return self.settle_commanded(choice, shone, now_us);
        }
        let last = self.device.last_exposed.filter(|id| id.job == self.plan.key && id.layer >= self.next_layer);
        if let Some(id) = last {
            let text = format!(
                "the device says it exposed layer {} of this job, but by the journal layer {} is next: the journal is not complete, \
                 the job cannot go on",
                id.layer, self.next_layer
            );
            return self.wind_down_at_rest(JobState::Failed, text, now_us);
        }
        self.advance(now_us);
    }

    /// Settles what became of the next layer, which was commanded.
    fn settle_commanded(&mut self, choice: ResumeChoice, shone: bool, now_us: u64) {
        let refused = self.refused.take();
        if let Some(text) = self.ended_early.take() {
            return self.doubt(&text, now_us);
        }
        let exposure_ms = self.plan.recipe.layer_exposure_ms(self.next_layer);
        match (fate(self.exposure_id(), self.unconfirmed, Some(exposure_ms), shone, &self.device), refused) {
            // The device forgot earlier exposures, so it may have forgotten this one as well.
            (Fate::NotExposed, _) if self.went_back.is_some() => {
                self.doubt("the device denies that it exposed it", now_us);
            }
            (Fate::NotExposed, Some(refusal)) => self.on_refused_unlit(refusal, now_us),
            (Fate::NotExposed, None) => {
                self.deny();
                self.advance(now_us);
            }
            (Fate::Exposed, Some(refusal)) if refusal != Refusal::AlreadyExposed => {
                let text =
                    format!("the device refused it ({refusal:?}), and says that it exposed it: check its firmware");
                self.doubt(&text, now_us);
            }
            (Fate::Unknown(why), Some(refusal)) => {
                let text = format!("the device refused it ({refusal:?}), and yet {why}: check its firmware");
                self.doubt(&text, now_us);
            }
            (Fate::Exposed, _) => {
                self.tell_exposed_whole(choice);
                match self.unconfirmed.and_then(|_| self.exposed_too_soon(now_us)) {
                    Some(text) => self.doubt(&text, now_us),
                    None => self.confirm(None, now_us),
                }
            }
            (Fate::Unknown(why), None) => self.settle_doubt(choice, &why, now_us),
        }
    }

    /// The device reports that it exposed the layer that was in doubt. Its word counts: it would refuse to expose it again.
    fn tell_exposed_whole(&mut self, choice: ResumeChoice) {
        let layer = self.next_layer;
        if choice == ResumeChoice::Repeat {
            self.out.notice(format!("layer {layer} is not repeated: the device reports that it exposed it whole"));
        }
        // The doubt arose in this run and ends it.
        if let (Some(why), Intent::End(JobState::Interrupted, _)) = (self.in_doubt.clone(), &self.intent) {
            let text = format!("{why}; since then the device reports that it exposed layer {layer} whole");
            self.intend_to_end(JobState::Interrupted, text);
        }
    }

    /// Only the operator can tell. They may have done so already.
    fn settle_doubt(&mut self, choice: ResumeChoice, why: &str, now_us: u64) {
        let layer = self.next_layer;
        match choice {
            ResumeChoice::None => self.doubt(why, now_us),
            ResumeChoice::AssumeExposed => {
                self.out.journal(Record::Decided { layer, exposed: true });
                self.count_as_exposed();
                self.advance(now_us);
            }
            ResumeChoice::Repeat => {
                self.out.journal(Record::Decided { layer, exposed: false });
                self.unconfirmed = None;
                self.in_doubt = None;
                self.advance(now_us);
            }
        }
    }

    /// Parks the plate and ends the job. Nothing is under way.
    pub(super) fn wind_down_at_rest(&mut self, state: JobState, reason: String, now_us: u64) {
        self.intend_to_end(state, reason);
        self.advance(now_us);
    }

    /// Sets how the job ends. The first intended end stays; later reasons are added to its reason.
    pub(super) fn intend_to_end(&mut self, state: JobState, reason: String) {
        match &mut self.intent {
            Intent::End(JobState::Completed, _) | Intent::Print | Intent::Pause => {
                self.intent = Intent::End(state, reason);
            }
            Intent::End(_, known) if known.contains(&reason) || known.len() > MAX_REASON_BYTES => {}
            Intent::End(_, known) if known.is_empty() => *known = reason,
            Intent::End(_, known) => *known = format!("{known}; {reason}"),
        }
    }
}
