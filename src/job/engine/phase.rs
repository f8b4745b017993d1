//! What the engine is doing, and what it intends to do. See the picture in `job/engine.rs`.

use crate::job::{EndOrder, JobState};

/// No further reason is added to one longer than this: journal records are limited in size.
const MAX_REASON_BYTES: usize = 1000;

/// What the engine intends to do with the job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Intent {
    Print,
    Pause,
    /// Park the machine, then end.
    End(End),
}

/// How the job ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct End {
    pub(super) state: JobState,
    pub(super) reason: String,
    /// The operator's order to end the job, so that it cannot be resumed.
    pub(super) ordered: Option<EndOrder>,
}

impl Intent {
    /// The end, if the job is to end.
    pub(super) fn end(&self) -> Option<&End> {
        match self {
            Self::End(end) => Some(end),
            Self::Print | Self::Pause => None,
        }
    }

    /// Whether the operator has aborted the job.
    pub(super) fn is_abort(&self) -> bool {
        self.ordered() == Some(EndOrder::Abort)
    }

    /// The operator's order to end the job.
    pub(super) fn ordered(&self) -> Option<EndOrder> {
        self.end().and_then(|end| end.ordered)
    }

    /// Whether the job is to print, or to end because it is complete.
    pub(super) fn is_printing(&self) -> bool {
        match self {
            Self::Print => true,
            Self::Pause => false,
            Self::End(end) => end.state == JobState::Completed,
        }
    }

    /// Replaces what was intended by an end. An order of the operator stays.
    pub(super) fn replace(&mut self, state: JobState, reason: String) {
        *self = Self::End(End { state, reason, ordered: self.ordered() });
    }

    /// Intends an end. The first intended end stays; later reasons are added to its reason.
    pub(super) fn add_end(&mut self, state: JobState, reason: String) {
        match self {
            Self::End(end) if end.state != JobState::Completed => end.add(reason),
            Self::End(_) | Self::Print | Self::Pause => self.replace(state, reason),
        }
    }
}

impl End {
    fn add(&mut self, reason: String) {
        if self.reason.contains(&reason) || self.reason.len() > MAX_REASON_BYTES {
            return;
        }
        if self.reason.is_empty() {
            self.reason = reason;
        } else {
            self.reason = format!("{}; {reason}", self.reason);
        }
    }
}

/// The step under way. The comment of a variant names the events that end it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Ready, Connected.
    Checking {
        /// The preflight has passed.
        ready: bool,
    },
    /// ActDone. An act of the cycle.
    Acting,
    /// Timeout. A wait of the cycle.
    Standing {
        /// Whether a pause or an end cuts it short.
        may_break_off: bool,
    },
    /// Uploaded. Waits for the first layer of a run, which is never late: the machine has not begun.
    WarmingUp,
    /// Uploaded. Waits for a late layer.
    Waiting {
        since_us: u64,
    },
    /// Journalled.
    Commanding,
    /// ActDone.
    Exposing {
        light_until_us: u64,
    },
    /// ActDone. The light was ordered off.
    CuttingShort,
    /// State, UrgentDone. Waits until the device has answered the light-off and reports dark.
    Darkening {
        until_us: u64,
    },
    /// Journalled.
    Confirming,
    /// ActDone. An act of the cycle that makes the part safe.
    Parking,
    /// Command.
    Resting,
    /// Connected.
    Lost,
    /// State, polled until the device is at rest.
    Asking {
        until_us: u64,
    },
    /// UrgentDone, Connected. The state is polled: a device that is still lit gets the abort again.
    AbortSent,
    /// Connected.
    AbortReconnect,
    /// Journalled.
    Ending,
    Done,
}
