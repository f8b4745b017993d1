//! What the engine is doing, and what it means to do next.

use crate::job::JobState;

/// Why the engine does not simply print on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Intent {
    Print,
    Pause,
    /// Park the plate, then end in that state for that reason.
    End(JobState, String),
}

/// The step under way; what ends it stands beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Ready, Connected.
    Checking,
    /// ActDone.
    Homing,
    /// Uploaded: the first layer of a run; the machine has not begun, so it is not late.
    WarmingUp,
    /// ActDone.
    Approaching,
    /// Timeout.
    Settling,
    /// Uploaded: a late layer.
    Waiting {
        since_us: u64,
    },
    /// Journalled.
    Commanding,
    /// ActDone.
    Exposing {
        light_until_us: u64,
    },
    /// ActDone, after a light-off.
    CuttingShort,
    /// State, UrgentDone: a device that was told to put its light off reports dark.
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
    /// State, asked for again and again until the device is at rest.
    Asking {
        until_us: u64,
    },
    /// UrgentDone, Connected; State, asked for again and again, where the device goes on shining.
    AbortSent,
    /// Connected.
    AbortReconnect,
    /// Journalled.
    Ending,
    Done,
}
