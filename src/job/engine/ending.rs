//! Every way out of printing but the abort: pause, stop, failure, fault, shutdown. Tested by `tests/job_engine/orders.rs`.

use super::next::Known;
use super::{Engine, Intent, Phase, SECOND_US};
use crate::job::{JobState, Record};
use crate::link::message::Fault;
use crate::text::plain_line;

/// At shutdown, an exposure that ends within this time is not cut short: a layer cut short is in doubt. Half a minute covers the
/// longest usual bottom exposure; systemd waits for two minutes.
const SHUTDOWN_EXPOSURE_US: u64 = 30 * SECOND_US;
/// Longest wait for the answer to an urgent order. A device answers within 100 ms; the rest is for the recovery of the line.
pub(super) const URGENT_US: u64 = 5 * SECOND_US;

impl Engine {
    /// Ends the job after the step under way.
    pub(super) fn wind_down(&mut self, state: JobState, reason: String, now_us: u64) {
        self.intent.add_end(state, reason);
        self.reconsider(matches!(state, JobState::Interrupted | JobState::Failed), now_us);
    }

    /// Parks the machine and ends the job. Nothing is under way.
    pub(super) fn wind_down_at_rest(&mut self, state: JobState, reason: String, now_us: u64) {
        self.intent.add_end(state, reason);
        self.advance(now_us);
    }

    /// After a change of intent: ends waits that are no longer needed. Acts under way run to their end. With `at_once`, acts that
    /// were not handed out yet are withdrawn.
    pub(super) fn reconsider(&mut self, at_once: bool, now_us: u64) {
        let is_to_end = matches!(self.intent, Intent::End(_));
        match self.phase {
            Phase::Standing { may_break_off: true } | Phase::WarmingUp | Phase::Waiting { .. } => self.advance(now_us),
            // There may be a part: wait for the device, to park it.
            Phase::Checking { .. } if self.part.is_possible() && !at_once => {}
            Phase::Checking { .. } | Phase::Resting if is_to_end => self.end(),
            Phase::Commanding if is_to_end && at_once => self.withdraw(now_us),
            Phase::Acting if is_to_end && at_once && self.out.act.is_some() => self.withdraw(now_us),
            Phase::Exposing { .. } if is_to_end && at_once && self.out.act.is_some() => self.withdraw(now_us),
            _ => {}
        }
    }

    /// Withdraws an act that was not handed out yet.
    pub(super) fn withdraw(&mut self, now_us: u64) {
        self.out.act = None;
        self.act.running = None;
        self.light.ended();
        if self.next.deny() {
            self.out.journal(Record::Withdrawn { exposure: self.next.number });
        }
        self.advance(now_us);
    }

    /// The machine cannot be parked. The operator must know if there may be a part, or the job was aborted.
    pub(super) fn unparked(&mut self, why: &str, now_us: u64) {
        if self.part.is_possible() || self.intent.is_abort() {
            let text = format!("{}: {why}", self.cycle.unparked_text());
            match self.intent.end().map(|end| end.state) {
                Some(state) => self.intent.add_end(state, text),
                None => self.out.notice(text),
            }
        }
        self.rest(now_us);
    }

    /// The machine is parked, or cannot be.
    pub(super) fn rest(&mut self, now_us: u64) {
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
    pub(super) fn end(&mut self) {
        self.out.forget_session();
        self.uploads.cancel();
        self.act.running = None;
        self.deadline = None;
        self.phase = Phase::Ending;
        let is_part_unparked = self.is_part_unparked();
        if self.part.is_possible() && !is_part_unparked {
            self.out.journal(Record::Parked);
        }
        if let Intent::End(end) = &mut self.intent {
            // A part left unsafe keeps the machine, unless the job was aborted.
            if end.state == JobState::Stopped && is_part_unparked {
                end.state = JobState::Interrupted;
            }
            let state = end.state;
            self.out.journal(Record::Ended { state, reason: self.end_reason() });
        }
    }

    /// The last record is on disk, or cannot be written.
    pub(super) fn finish(&mut self) {
        self.phase = Phase::Done;
        if let Some(end) = self.intent.end() {
            self.out.finished = Some((end.state, self.end_reason()));
        }
    }

    /// Ends a job before it commanded anything. A part on the machine keeps it, whatever was ordered.
    pub(super) fn end_unbegun(&mut self, text: &str) {
        if self.part.is_possible() {
            self.intent.replace(JobState::Interrupted, format!("{text}; {}", self.cycle.unparked_text()));
        } else {
            self.intent.replace(JobState::Failed, text.into());
        }
        self.end();
    }

    /// Ends the job without moving the machine.
    pub(super) fn end_unparked(&mut self, text: String) {
        self.intent.add_end(JobState::Interrupted, text);
        self.end();
    }

    /// End state of a job that cannot go on: failed without light, else interrupted, so that it can be resumed.
    pub(super) fn failed_or_interrupted(&self) -> JobState {
        if self.part.is_possible() { JobState::Interrupted } else { JobState::Failed }
    }

    /// It is unknown how much light the commanded layer had.
    pub(super) fn doubt(&mut self, why: &str, now_us: u64) {
        if self.next.doubt().is_none() {
            self.out.journal(Record::InDoubt { exposure: self.next.number, why: why.to_owned() });
        }
        self.next.known = Known::InDoubt(why.to_owned());
        self.intent.add_end(JobState::Interrupted, String::new());
        self.advance(now_us);
    }

    /// Ends a running exposure early.
    pub(super) fn cut_short(&mut self, now_us: u64) {
        self.put_light_off();
        self.wait_until(Phase::CuttingShort, now_us + URGENT_US);
    }

    pub(super) fn shutdown(&mut self, now_us: u64) {
        const STOPPED: &str = "the daemon was stopped: `layerctl resume` goes on, `layerctl abort` ends the job";
        let is_abort = self.intent.is_abort();
        match self.phase {
            Phase::Checking { .. } if self.part.is_possible() => return self.end_unbegun(STOPPED),
            // It ends as aborted: the machine parks, or the engine waits for the line, a minute at most.
            _ if is_abort => {}
            _ => self.wind_down(JobState::Interrupted, STOPPED.into(), now_us),
        }
        match &mut self.phase {
            Phase::Lost if !is_abort => self.end(),
            Phase::Acting if !is_abort && self.cycle.may_be_left() => self.end(),
            Phase::Asking { until_us } => *until_us = (*until_us).min(now_us + SHUTDOWN_EXPOSURE_US),
            Phase::Exposing { light_until_us } if *light_until_us > now_us + SHUTDOWN_EXPOSURE_US => {
                // A machine that can go on with the layer stops by itself where that is safe, once the session ends.
                if self.cycle.continues() { self.end() } else { self.cut_short(now_us) }
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

    pub(super) fn on_journal_failed(&mut self, text: &str, now_us: u64) {
        self.out.journal_failed();
        if self.phase == Phase::Ending {
            return self.finish();
        }
        let reason = format!("the journal cannot be written: {text}. Fix that, then resume");
        self.intent.add_end(JobState::Interrupted, reason);
        match self.phase {
            Phase::Commanding => {
                self.next.deny();
                self.advance(now_us);
            }
            Phase::Confirming => self.advance(now_us),
            _ => self.reconsider(true, now_us),
        }
    }
}

fn fault_text(fault: &Fault) -> String {
    format!("the device reports fault {} ({}): clear it, then resume", fault.code, plain_line(&fault.text))
}
