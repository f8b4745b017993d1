//! What the engine tells about the job: state, progress and reason.

use super::disk::WAITS_FOR_DISK;
use super::{Engine, Intent, Phase};
use crate::job::{JobState, Progress, Unconfirmed};

impl Engine {
    /// Where the job stands.
    pub fn progress(&self) -> Progress {
        Progress {
            state: self.state(),
            layer: self.next_layer,
            layers_done: self.next_layer,
            layers_total: self.plan.layer_count,
            late_layers: self.pace.late_layers,
            late_ms_total: self.pace.late_us_total / 1000,
            exposing: matches!(self.phase, Phase::Exposing { .. } | Phase::CuttingShort),
            eta_ms: self.is_printing().then(|| self.pace.remaining_ms(&self.plan, self.next_layer)),
            light_ms: self.light_ms,
            in_doubt: self.in_doubt.is_some().then_some(self.next_layer),
            reason: self.reason(),
            part_in_vat: self.touched && !self.lifted,
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
        self.touched
    }

    /// Whether the job is to print and has had no light yet. It moves the plate down, so the plate must be empty.
    pub fn goes_down_bare(&self) -> bool {
        !self.touched && !self.aborting && !self.is_over() && matches!(self.intent, Intent::Print | Intent::Pause)
    }

    /// Whether the job has ended. Its last record may still be unwritten.
    pub fn is_over(&self) -> bool {
        matches!(self.phase, Phase::Ending | Phase::Done)
    }

    /// Whether the job has begun, so that acts may have been commanded.
    pub fn has_begun(&self) -> bool {
        self.phase != Phase::Checking
    }

    /// The layer that was commanded and neither confirmed nor denied.
    pub fn unconfirmed(&self) -> Option<Unconfirmed> {
        self.unconfirmed
    }

    /// Whether layers are being printed. Nobody can predict the end of a pause or of a lost line.
    fn is_printing(&self) -> bool {
        let at_work =
            !matches!(self.phase, Phase::Checking | Phase::Lost | Phase::Resting | Phase::Ending | Phase::Done);
        at_work && matches!(self.intent, Intent::Print | Intent::End(JobState::Completed, _))
    }

    /// The job's state.
    pub fn state(&self) -> JobState {
        match (&self.phase, &self.intent) {
            // Only once its record is on disk and the machine is free: the job can be resumed from then on.
            (Phase::Done, Intent::End(state, _)) => *state,
            _ if self.aborting => JobState::Aborting,
            (Phase::Checking, Intent::Print | Intent::Pause) => JobState::Checking,
            (Phase::Resting, Intent::Pause) => JobState::Paused,
            (_, Intent::Pause) => JobState::Pausing,
            (_, Intent::End(JobState::Completed, _) | Intent::Print) => JobState::Printing,
            (_, Intent::End(..)) => JobState::Stopping,
        }
    }

    fn reason(&self) -> String {
        match (&self.intent, &self.phase) {
            (Intent::End(..), _) => {
                let texts = [self.end_reason(), self.wait_before_end()];
                texts.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; ")
            }
            (_, Phase::Lost) => format!("waiting for the device: {}", self.loss),
            (_, Phase::Commanding | Phase::Confirming | Phase::Resting) if self.disk.is_slow() => WAITS_FOR_DISK.into(),
            (_, Phase::Checking) if self.ready => "waiting for the device".into(),
            (_, Phase::Darkening { .. }) => "waiting for the device to report dark".into(),
            (_, Phase::Asking { .. }) => "waiting for the device to come to rest".into(),
            (_, Phase::Waiting { .. }) => format!("layer {} is late; the device waits dark", self.next_layer),
            (_, Phase::WarmingUp) => format!("layer {} is being computed and sent", self.next_layer),
            _ => String::new(),
        }
    }
}
