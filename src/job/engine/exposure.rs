//! One exposure: journal, command, compare, confirm. See it tested by `tests/job_lies/dose.rs`.

use super::next::{Known, Sign};
use super::track::PartState;
use super::{Engine, Phase};
use crate::deadline::Deadline;
use crate::device::{Dose, Outcome};
use crate::job::cycle::Lit;
use crate::job::{JobState, Record};
use crate::link::message::{DeviceState, ExposureId, Refusal};

/// How often one layer may be commanded. Every time but the first follows a lost line or a refusal.
const MAX_COMMANDS: u32 = 10;

impl Engine {
    pub(super) fn command_exposure(&mut self, now_us: u64) {
        let exposure = self.next.number;
        self.next.commands += 1;
        if self.next.commands > MAX_COMMANDS {
            let layer = self.next_text();
            let text = format!("{layer} was commanded {MAX_COMMANDS} times without success; check the device");
            return self.wind_down(JobState::Interrupted, text, now_us);
        }
        let boot_id = self.device.boot_id;
        if self.part == PartState::Absent {
            self.exposed_before = self.exposed_by_another();
            if let Some(ExposureId { job, layer, pass }) = self.exposed_before {
                self.out.journal(match pass {
                    0 => Record::LastExposed { job, layer },
                    pass => Record::LastExposedPass { job, layer, pass },
                });
            }
        }
        self.next.known = Known::Commanded { boot_id, sign: Sign::None };
        self.out.journal(Record::Commanded { exposure, boot_id });
        self.phase = Phase::Commanding;
        self.deadline = None;
    }

    /// The command is on disk.
    pub(super) fn expose(&mut self, now_us: u64) {
        let exposure = self.cycle.exposure(self.next.number);
        self.part = self.part.max(PartState::Possible);
        self.light.command(self.exposure_id(), exposure.limit_ms, now_us);
        let light_until_us = now_us + u64::from(exposure.limit_ms) * 1000;
        let limit_us = self.light.limit_us().unwrap_or(light_until_us);
        self.start_act(exposure.act, exposure.least_us, Phase::Exposing { light_until_us }, limit_us, now_us);
    }

    /// The device has received the act under way. The machine stood still until then.
    pub(super) fn on_act_taken(&mut self, number: u64, now_us: u64) {
        if self.act.running != Some(number) {
            return;
        }
        if let Some(decided_us) = self.act.decided_us.take() {
            self.pace.waited(now_us.saturating_sub(decided_us));
        }
        if matches!(self.phase, Phase::Exposing { .. }) {
            self.light.taken(now_us);
            self.deadline = self.light.limit_us().map(Deadline::at);
        }
    }

    pub(super) fn on_exposure_done(&mut self, outcome: Outcome, now_us: u64) {
        if !matches!(outcome, Outcome::Refused(refusal) if refusal != Refusal::CutShort) {
            self.light.ended();
        }
        if let Some(text) = self.next.take_early_end() {
            return self.doubt(&text, now_us);
        }
        match outcome {
            Outcome::TakenBack => self.withdraw(now_us),
            Outcome::Refused(refusal) => self.on_exposure_refused(refusal, now_us),
            outcome => match self.cycle.judge(self.next.number, outcome) {
                Some(lit) => self.on_exposed(lit, now_us),
                None => self.on_wrong_outcome(outcome, now_us),
            },
        }
    }

    /// Compares the reported light time with the commanded one.
    fn on_exposed(&mut self, lit: Lit, now_us: u64) {
        if let Some(text) = self.exposed_too_soon(now_us) {
            return self.doubt(&text, now_us);
        }
        let (exposure, layer) = (self.next.number, self.next_text());
        let Lit { light_ms, starved_ms, dose } = lit;
        self.pace.waited(self.plan.host_us(u64::from(starved_ms) * 1000));
        let text = format!(
            "the device reports {light_ms} ms of light for {layer} instead of {} ms",
            self.cycle.light_ms(exposure).unwrap_or(0)
        );
        match dose {
            Dose::TooLittle => return self.doubt(&text, now_us),
            Dose::TooMuch => {
                self.intent.add_end(JobState::Interrupted, format!("{text}: check its firmware, then resume"));
            }
            Dose::Right => {}
        }
        self.confirm(Some(light_ms), now_us);
    }

    /// Describes the error if the last exposure is reported to have ended sooner than it can by the host's clock.
    pub(super) fn exposed_too_soon(&self, now_us: u64) -> Option<String> {
        let too_soon = self.too_soon(now_us)?;
        Some(format!(
            "the device says that {} had its {} ms of light, but only {} ms have passed since the order{}",
            self.next_text(),
            self.cycle.light_ms(self.next.number).unwrap_or(0),
            too_soon.took_us / 1000,
            too_soon.hint
        ))
    }

    /// A state names the layer under way as exposed sooner than it can be: the light goes off, and the layer is in doubt.
    pub(super) fn look_for_early_end(&mut self, state: &DeviceState, now_us: u64) {
        let under_way = self.out.act.is_none() && matches!(self.phase, Phase::Exposing { .. } | Phase::CuttingShort);
        if under_way
            && matches!(self.next.known, Known::Commanded { sign: Sign::None, .. })
            && state.last_exposed == Some(self.exposure_id())
            && let Some(text) = self.exposed_too_soon(now_us)
        {
            self.next.note(Sign::EndedEarly(text));
            self.cut_short(now_us);
        }
    }

    /// The device says that it exposed the commanded layer. `light_ms` is the reported light time, if it names one.
    pub(super) fn confirm(&mut self, light_ms: Option<u32>, now_us: u64) {
        self.part = PartState::Confirmed;
        let exposure = self.next.number;
        self.pace.confirmed(self.plan.exposure_ms(exposure), light_ms, now_us);
        self.out.journal(Record::Confirmed { exposure });
        self.count_as_exposed();
        self.phase = Phase::Confirming;
        self.deadline = None;
        if self.out.journal_broken {
            self.advance(now_us);
        }
    }

    /// Goes on to the next exposure.
    pub(super) fn count_as_exposed(&mut self) {
        self.uploads.release(self.next.number);
        self.next.advance();
        self.cycle.note_exposed();
        self.part = self.part.max(PartState::Possible);
        self.failures.layer_printed();
    }

    /// The device has marked the commanded layer up to this vector, and goes on there.
    pub(super) fn on_partly_marked(&mut self, next_vector: u32, now_us: u64) {
        let (exposure, layer) = (self.next.number, self.next_text());
        match self.cycle.marked_to(exposure, next_vector) {
            None => {
                let text =
                    format!("the device says that it marked {layer} up to vector {next_vector}, which cannot be");
                return self.doubt(&text, now_us);
            }
            Some(0) => {}
            Some(_) => self.next.commands = 0,
        }
        self.next.known = Known::Dark;
        self.out.journal(Record::PartlyMarked { exposure, next_vector });
        self.uploads.release(exposure);
        self.out.notice(format!("{layer} was marked up to vector {next_vector}; it goes on there"));
        self.advance(now_us);
    }

    /// The device says that the commanded layer had no light.
    pub(super) fn deny(&mut self) {
        if self.next.deny() {
            self.out.journal(Record::NotExposed { exposure: self.next.number });
        }
    }

    /// The records so far are on disk.
    pub(super) fn on_journal_idle(&mut self, now_us: u64) {
        match self.phase {
            Phase::Commanding => self.expose(now_us),
            Phase::Confirming => {
                let step = self.cycle.after_exposure();
                self.take(step, now_us);
            }
            Phase::Ending => self.finish(),
            _ => {}
        }
    }
}
