//! The steps of the cycle: asks the cycle for them, carries them out, and reports their ends. See it
//! tested by `tests/job_engine/printing.rs` and `tests/job_lies/plate.rs`.

use super::{Engine, Intent, LATE_LIMIT_US, Phase};
use crate::device::{Outcome, ScanTimes};
use crate::job::JobState;
use crate::job::cycle::{Done, Goal, Step, TooSoon};
use crate::link::message::DeviceState;

impl Engine {
    /// Takes the next step. No act and no unconfirmed exposure may be under way.
    pub(super) fn advance(&mut self, now_us: u64) {
        if !self.line.is_up() {
            return self.lose(now_us);
        }
        if self.light.must_wait() {
            return self.darken(now_us);
        }
        if self.intent == Intent::Print && self.next.number == self.plan.passes.exposure_count() {
            self.intent.replace(JobState::Completed, String::new());
        }
        if self.intent != Intent::Print {
            return self.park(now_us);
        }
        let step = self.cycle.prepare(self.next.number, self.part.is_possible());
        self.take(step, now_us);
    }

    /// Carries out a step on the way to the next layer.
    pub(super) fn take(&mut self, step: Step, now_us: u64) {
        self.take_in(Phase::Acting, step, now_us);
    }

    /// Brings the machine to where the part is safe.
    pub(super) fn park(&mut self, now_us: u64) {
        let step = self.cycle.park(self.next.number, self.immobile);
        self.take_in(Phase::Parking, step, now_us);
    }

    /// Carries out a step. If it is an act, `phase` lasts until its end.
    fn take_in(&mut self, phase: Phase, step: Step, now_us: u64) {
        match step {
            Step::Free => self.advance(now_us),
            Step::Clear => self.begin_layer(now_us),
            Step::Ready => self.want_layer(now_us),
            Step::Act { act, most_us, least_us } => self.start_act(act, least_us, phase, now_us + most_us, now_us),
            Step::Wait { us, may_break_off } => self.wait_until(Phase::Standing { may_break_off }, now_us + us),
            Step::Parked => self.rest(now_us),
            Step::Unparked(why) => self.unparked(why, now_us),
            Step::Halt(text) => self.end_unparked(text),
        }
    }

    /// Nothing is left to do for the layers before.
    fn begin_layer(&mut self, now_us: u64) {
        if !self.uploads.may_begin(self.next.number) {
            return self.wait_until(Phase::WarmingUp, now_us + LATE_LIMIT_US);
        }
        let step = self.cycle.begin(self.next.number);
        self.take(step, now_us);
    }

    /// The machine is ready for the layer: commands it, or waits for it.
    fn want_layer(&mut self, now_us: u64) {
        if self.uploads.holds(self.next.number) {
            return self.command_exposure(now_us);
        }
        self.wait_until(Phase::Waiting { since_us: now_us }, now_us + LATE_LIMIT_US);
    }

    pub(super) fn on_uploaded(&mut self, exposure: u32, times: Option<ScanTimes>, now_us: u64) {
        self.cycle.sent(exposure, times);
        if !self.uploads.uploaded(exposure) || exposure != self.next.number {
            return;
        }
        match self.phase {
            Phase::WarmingUp => self.advance(now_us),
            Phase::Waiting { since_us } => {
                self.pace.waited(now_us.saturating_sub(since_us));
                self.command_exposure(now_us);
            }
            _ => {}
        }
    }

    pub(super) fn on_act_done(&mut self, outcome: Outcome, now_us: u64) {
        if matches!(self.phase, Phase::Exposing { .. } | Phase::CuttingShort) {
            return self.on_exposure_done(outcome, now_us);
        }
        match outcome {
            Outcome::TakenBack => return self.withdraw(now_us),
            Outcome::Refused(refusal) => return self.on_act_refused(refusal, now_us),
            _ => {}
        }
        let goal = if self.intent == Intent::Print { Goal::Print } else { Goal::Park };
        let too_soon = self.too_soon(now_us);
        if matches!(self.phase, Phase::Acting | Phase::Parking)
            && let Some(Done { problem, step }) = self.cycle.done(outcome, self.next.number, too_soon.as_ref(), goal)
        {
            self.deadline = None;
            if let Some(problem) = problem {
                self.intent.add_end(self.failed_or_interrupted(), problem);
            }
            return self.take(step, now_us);
        }
        self.on_wrong_outcome(outcome, now_us);
    }

    /// The driver reports an outcome of an act that is not under way.
    pub(super) fn on_wrong_outcome(&mut self, outcome: Outcome, now_us: u64) {
        let text = format!("the device answered {outcome:?}, which does not fit the act; check its firmware");
        if self.next.unconfirmed().is_some() {
            self.doubt(&text, now_us);
        } else {
            self.end_unparked(text);
        }
    }

    /// The time that the last act took, if it cannot have ended yet.
    pub(super) fn too_soon(&self, now_us: u64) -> Option<TooSoon> {
        let took_us = self.act.too_soon_us(now_us)?;
        Some(TooSoon { took_us, hint: self.time_scale_hint() })
    }

    fn time_scale_hint(&self) -> String {
        let hint = format!(
            " (is the device simulated? Set `time_scale` in the machine file, now {}, to its `--time-scale`, and restart layerd)",
            self.plan.time_scale
        );
        // One cause leads to several reports.
        if self.end_reason().contains(&hint) { String::new() } else { hint }
    }

    /// An act of the cycle has not ended in time.
    pub(super) fn on_overdue_act(&mut self, now_us: u64) {
        let text = self.cycle.overdue_text(self.act.decided_us.is_none());
        self.on_misbehaved(&self.line.with_cause(&text), now_us);
    }

    /// Compares where the machine is with where it was left. Nothing moves it by order in these phases.
    pub(super) fn watch_machine(&mut self, state: &DeviceState, now_us: u64) {
        use Phase::{Acting, Commanding, Confirming, Exposing, Resting, Standing, Waiting, WarmingUp};
        let moved = match self.phase {
            Resting => {
                self.cycle.rest(state);
                None
            }
            Standing { .. } | WarmingUp | Waiting { .. } | Commanding | Exposing { .. } | Confirming => {
                self.cycle.moved(state)
            }
            // An act that still waits for the disk has not begun.
            Acting if self.out.act.is_some() || self.cycle.plate_rests() => self.cycle.moved(state),
            _ => None,
        };
        if let Some(text) = moved {
            self.wind_down(self.failed_or_interrupted(), text, now_us);
        }
    }
}
