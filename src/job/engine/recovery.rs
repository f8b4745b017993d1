//! Finding out what the device did: at the start, after a lost line, after a crash of the host. Tested by
//! `tests/job_engine/disturbances.rs` and `tests/job_lies/memory.rs`.

use super::next::{Known, Sign};
use super::track::{PartState, id_text};
use super::{Engine, Phase, SECOND_US};
use crate::deadline::Deadline;
use crate::device::Light;
use crate::job::{Fate, JobState, Record, ResumeChoice, fate};
use crate::link::message::{DeviceState, ExposureId, Refusal};

/// Polling interval while the device still moves or exposes.
const ASK_EVERY_US: u64 = SECOND_US / 2;
/// Longest wait for the device to come to rest: the longest exposure of a recipe (ten minutes) and a margin.
const ASK_LIMIT_US: u64 = 620 * SECOND_US;

impl Engine {
    pub(super) fn notice_state(&mut self, state: DeviceState) {
        self.compare_exposed(&state);
        self.cycle.locate(&state);
        self.device = state;
    }

    /// Checks that the layer reported as exposed last never goes back. Returns whether it has gone back just now.
    fn compare_exposed(&mut self, state: &DeviceState) -> bool {
        let told = state.last_exposed.filter(|id| id.job == self.plan.key);
        told.is_some_and(|id| self.memory.compare(id))
    }

    /// The device reported its state. In every phase its light is compared with what was commanded.
    pub(super) fn on_state(&mut self, state: DeviceState, now_us: u64) {
        if !self.line.is_up() {
            return;
        }
        let light = self.light.observe(&state, now_us);
        self.look_for_early_end(&state, now_us);
        let has_gone_back = self.compare_exposed(&state);
        let waits = matches!(self.phase, Phase::Checking { .. } | Phase::Asking { .. } | Phase::Darkening { .. });
        if has_gone_back
            && !waits
            && let Some(text) = self.went_back_text()
        {
            self.wind_down(JobState::Interrupted, text, now_us);
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
            _ => self.watch_machine(&state, now_us),
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
        let id = self.exposure_id();
        let is_ours = self.next.unconfirmed().is_some_and(|commanded| commanded.boot_id == state.boot_id);
        if is_ours && state.exposing == Some(id) {
            self.light.found(id, self.cycle.leftover_ms(self.next.number), now_us);
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
        if self.intent.is_abort() {
            return self.advance(now_us);
        }
        if self.was_displaced() {
            let text = "the device has exposed layers of another job since: this job's part is no longer where it was. Abort it";
            return self.end_unparked(text.into());
        }
        if let Some(text) = self.went_back_text() {
            self.intent.add_end(JobState::Interrupted, text);
        }
        let shone = self.light.has_shone(self.exposure_id());
        self.light.ended();
        // The operator's choice is for this layer as it is now, not for a later one.
        let choice = std::mem::take(&mut self.next.choice);
        if self.next.known != Known::Dark {
            return self.judge_commanded(choice, shone, now_us);
        }
        let id = self.exposure_id();
        let last = self.device.last_exposed.filter(|last| last.job == id.job && *last >= id);
        if let Some(last) = last {
            let text = format!(
                "the device says it exposed {} of this job, but according to the journal {} is next: the journal is not complete, \
                 the job cannot go on",
                id_text(last),
                self.next_text()
            );
            return self.wind_down_at_rest(JobState::Failed, text, now_us);
        }
        self.advance(now_us);
    }

    /// What the device exposed last, if that is of another job.
    pub(super) fn exposed_by_another(&self) -> Option<ExposureId> {
        self.device.last_exposed.filter(|id| id.job != self.plan.key)
    }

    /// Whether the device has exposed layers of another job since this one had light.
    fn was_displaced(&self) -> bool {
        let Some(other) = self.exposed_by_another() else { return false };
        match self.part {
            PartState::Absent => false,
            // The device may have had no light for this job yet, and still name what it exposed before.
            PartState::Possible => self.exposed_before != Some(other),
            PartState::Confirmed => true,
        }
    }

    /// Finds out what became of the next layer, which was commanded.
    fn judge_commanded(&mut self, choice: ResumeChoice, shone: bool, now_us: u64) {
        let refused = match self.next.take_sign() {
            Sign::None => None,
            Sign::Refused(refusal) => Some(refusal),
            Sign::EndedEarly(text) => return self.doubt(&text, now_us),
        };
        let exposure_ms = self.cycle.light_ms(self.next.number);
        let commanded = self.next.unconfirmed();
        match (fate(self.exposure_id(), commanded, exposure_ms, shone, &self.device), refused) {
            // The device forgot earlier exposures, so it may have forgotten this one as well.
            (Fate::NotExposed, _) if self.memory.went_back().is_some() => {
                self.doubt("the device says that it did not expose it", now_us);
            }
            (Fate::NotExposed, Some(refusal)) => self.on_refused_unlit(refusal, now_us),
            (Fate::NotExposed, None) => {
                self.deny();
                self.advance(now_us);
            }
            // Only the operator can tell whether a vector that is marked in part may be marked again.
            (Fate::Partly { broken: Some(why), .. }, _) if choice != ResumeChoice::Repeat => {
                self.decide(choice, &why, now_us);
            }
            (Fate::Partly { next_vector, .. }, _) => self.on_partly_marked(next_vector, now_us),
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
                match commanded.and_then(|_| self.exposed_too_soon(now_us)) {
                    Some(text) => self.doubt(&text, now_us),
                    None => self.confirm(None, now_us),
                }
            }
            (Fate::Unknown(why), None) => self.decide(choice, &why, now_us),
        }
    }

    /// The device reports that it exposed the layer that was in doubt. Its word counts: it would refuse to expose it again.
    fn tell_exposed_whole(&mut self, choice: ResumeChoice) {
        let layer = self.next_text();
        if choice == ResumeChoice::Repeat {
            self.out.notice(format!("{layer} is not repeated: the device reports that it exposed it whole"));
        }
        // The doubt arose in this run and ends it.
        let is_interrupted = self.intent.end().is_some_and(|end| end.state == JobState::Interrupted);
        if let Some(why) = self.next.doubt().filter(|_| is_interrupted) {
            let text = format!("{why}; since then the device reports that it exposed {layer} whole");
            self.intent.add_end(JobState::Interrupted, text);
        }
    }

    /// Only the operator can tell. They may have done so already.
    fn decide(&mut self, choice: ResumeChoice, why: &str, now_us: u64) {
        let exposure = self.next.number;
        match choice {
            ResumeChoice::None => self.doubt(why, now_us),
            ResumeChoice::AssumeExposed => {
                self.out.journal(Record::Decided { exposure, exposed: true });
                self.count_as_exposed();
                self.advance(now_us);
            }
            ResumeChoice::Repeat => {
                self.out.journal(Record::Decided { exposure, exposed: false });
                self.next.known = Known::Dark;
                self.advance(now_us);
            }
        }
    }

    /// What the operator must know if the device's memory has gone back.
    fn went_back_text(&self) -> Option<String> {
        let text = self.memory.went_back()?;
        Some(format!("{text}: look at the device and the part, then resume"))
    }
}
