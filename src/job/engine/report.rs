//! What the engine tells about the job: state, progress and reason. The daemon shows it as `layerctl status`.

use super::disk::WAITS_FOR_DISK;
use super::{Engine, Intent, Phase};
use crate::job::{JobState, Progress, Unconfirmed};

impl Engine {
    /// Whether the operator has ordered a pause, and neither resumed the job nor ended it since.
    pub fn is_to_pause(&self) -> bool {
        self.intent == Intent::Pause
    }

    /// Where the job stands.
    pub fn progress(&self) -> Progress {
        let next = self.plan.passes.at(self.next.number);
        Progress {
            state: self.state(),
            layer: next.layer,
            material: self.plan.passes.material(self.next.number).map(str::to_owned),
            exposures_done: self.next.number,
            layers_done: next.layer,
            layers_total: self.plan.passes.layer_count(),
            late_layers: self.pace.late_layers,
            late_ms_total: self.pace.late_us_total / 1000,
            exposing: matches!(self.phase, Phase::Exposing { .. } | Phase::CuttingShort),
            eta_ms: self.is_printing().then(|| self.pace.remaining_ms(&self.plan, self.next.number)),
            light_ms: self.pace.light_ms,
            in_doubt: self.next.doubt().is_some().then_some(next.layer),
            reason: self.reason(),
            part_unparked: self.is_part_unparked(),
        }
    }

    /// Whether the operator's order to end the job is not on disk yet.
    pub fn order_unwritten(&self) -> bool {
        self.out.order_unwritten()
    }

    /// Whether a record could not be written. The job then ends, and its journal is incomplete.
    pub fn journal_failed(&self) -> bool {
        self.out.journal_broken
    }

    /// Whether the job may have had light, so that a part on the plate is its own.
    pub fn touched(&self) -> bool {
        self.part.is_possible()
    }

    /// Whether the machine is not parked and there may be a part.
    pub(super) fn is_part_unparked(&self) -> bool {
        self.part.is_possible() && !self.cycle.is_parked()
    }

    /// Whether the job is to print and has had no light yet. It moves the plate down, so the plate must be empty.
    pub fn goes_down_bare(&self) -> bool {
        !self.part.is_possible() && !self.is_over() && matches!(self.intent, Intent::Print | Intent::Pause)
    }

    /// Whether the job has ended. Its last record may still be unwritten.
    pub fn is_over(&self) -> bool {
        matches!(self.phase, Phase::Ending | Phase::Done)
    }

    /// Whether the job has begun, so that acts may have been commanded.
    pub fn has_begun(&self) -> bool {
        !matches!(self.phase, Phase::Checking { .. })
    }

    /// The layer that was commanded and neither confirmed nor denied.
    pub fn unconfirmed(&self) -> Option<Unconfirmed> {
        self.next.unconfirmed()
    }

    /// Whether layers are being printed. Nobody can predict the end of a pause or of a lost line.
    fn is_printing(&self) -> bool {
        use Phase::{Checking, Done, Ending, Lost, Resting};
        !matches!(self.phase, Checking { .. } | Lost | Resting | Ending | Done) && self.intent.is_printing()
    }

    /// The job's state.
    pub fn state(&self) -> JobState {
        match (&self.phase, &self.intent) {
            // Only once its record is on disk and the machine is free: the job can be resumed from then on.
            (Phase::Done, Intent::End(end)) => end.state,
            (_, intent) if intent.is_abort() => JobState::Aborting,
            (Phase::Checking { .. }, Intent::Print | Intent::Pause) => JobState::Checking,
            (Phase::Resting, Intent::Pause) => JobState::Paused,
            (_, Intent::Pause) => JobState::Pausing,
            (_, intent) if intent.is_printing() => JobState::Printing,
            _ => JobState::Stopping,
        }
    }

    /// What the job waits for or why it ends, for people.
    fn reason(&self) -> String {
        match (&self.intent, &self.phase) {
            (Intent::End(_), _) => {
                let texts = [self.end_reason(), self.wait_before_end()];
                texts.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; ")
            }
            (_, Phase::Lost) => self.lost_text(),
            (_, Phase::Commanding | Phase::Confirming | Phase::Resting) if self.disk.is_slow() => WAITS_FOR_DISK.into(),
            (_, Phase::Checking { ready: true }) => WAITS_FOR_DEVICE.into(),
            (_, Phase::Darkening { .. }) => "waiting for the device to report dark".into(),
            (_, Phase::Asking { .. }) => "waiting for the device to come to rest".into(),
            (_, Phase::Waiting { .. }) => format!("{} is late; the device waits dark", self.next_text()),
            (_, Phase::WarmingUp) => format!("{} is being computed and sent", self.next_text()),
            _ => String::new(),
        }
    }

    /// What an ending job waits for if the device or the disk does not answer; else empty.
    fn wait_before_end(&self) -> String {
        let may_be_lit = !self.abort_order.is_dark;
        match self.phase {
            // A device that took the abort is dark until the new session begins.
            Phase::AbortSent if !self.line.is_up() && may_be_lit => ABORT_WAITS.into(),
            Phase::AbortReconnect if may_be_lit => ABORT_WAITS.into(),
            Phase::Lost => self.lost_text(),
            Phase::Checking { .. } if !self.line.is_up() => WAITS_FOR_DEVICE.into(),
            Phase::Commanding | Phase::Confirming | Phase::Ending if self.disk.is_slow() => WAITS_FOR_DISK.into(),
            _ => String::new(),
        }
    }

    fn lost_text(&self) -> String {
        format!("{WAITS_FOR_DEVICE}: {}", self.line.loss)
    }

    /// Why the job ends, and what to do.
    pub(super) fn end_reason(&self) -> String {
        let Some(end) = self.intent.end() else { return String::new() };
        let layer = self.next_text();
        let doubt = self.next.doubt().map(|why| format!("{layer} is in doubt: {why}{DECIDE}"));
        let texts: Vec<_> =
            doubt.iter().chain(Some(&end.reason).filter(|reason| !reason.is_empty())).map(String::as_str).collect();
        let text = texts.join("; ");
        if end.ordered.is_some() { text.replace(DECIDE, "").replace(THEN_RESUME, "") } else { text }
    }
}

/// Advice for a layer in doubt. Both texts are left out for a job that cannot be resumed.
const DECIDE: &str = ". Look at the part, then resume with `--in-doubt exposed` or `--in-doubt repeat`";
const THEN_RESUME: &str = ", then resume";
const WAITS_FOR_DEVICE: &str = "waiting for the device";
const ABORT_WAITS: &str = "waiting for the device, which does not answer: if there is light or the plate moves, switch the printer off \
     at the mains";
