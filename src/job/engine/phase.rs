//! What the engine is doing, and what it intends to do.

use crate::job::JobState;

/// What the engine intends to do with the job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Intent {
    Print,
    Pause,
    /// Park the plate, then end in this state for this reason.
    End(JobState, String),
}

/// The step under way. The comment of a variant names the events that end it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Ready, Connected.
    Checking,
    /// ActDone.
    Homing,
    /// Uploaded. Waits for the first layer of a run, which is never late: the machine has not begun.
    WarmingUp,
    /// ActDone.
    Approaching,
    /// Timeout.
    Settling,
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
    /// Timeout.
    Curing,
    /// ActDone.
    Lifting,
    /// Timeout.
    Dripping,
    /// ActDone.
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
