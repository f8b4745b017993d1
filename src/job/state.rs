//! The states of a job.
//!
//! ```
//! use layerd::job::JobState;
//!
//! assert!(JobState::Paused.is_active(), "it holds the machine");
//! assert!(!JobState::Interrupted.is_final(), "it can be resumed");
//! assert_eq!(JobState::Stopped.to_string(), "stopped");
//! ```

use bincode::{Decode, Encode};
use serde::{Deserialize, Serialize};

/// Where a job is in its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Encode, Decode)]
#[serde(rename_all = "lowercase")]
pub enum JobState {
    /// Waiting for the machine.
    Queued,
    /// Preflight: whether the part fits the build volume and the memory budget, and whether the device is the right one.
    Checking,
    /// Layers are being exposed.
    Printing,
    /// The layer under way ends, then the machine parks.
    Pausing,
    /// Dark, machine parked, waiting for resume.
    Paused,
    /// The layer under way ends, then the machine parks and the job ends.
    Stopping,
    /// Light off first, then the machine parks and the job ends.
    Aborting,
    /// Every layer exposed.
    Completed,
    /// Ended by the operator after a whole layer.
    Stopped,
    /// Ended by the operator at once.
    Aborted,
    /// Ended by an error; cannot be resumed.
    Failed,
    /// Ended by a crash, a power cut, a lost line, a shutdown or an error that can be repaired; can be resumed.
    Interrupted,
}

impl JobState {
    /// Whether the job holds the machine.
    pub fn is_active(self) -> bool {
        use JobState::{Aborting, Checking, Paused, Pausing, Printing, Stopping};
        matches!(self, Checking | Printing | Pausing | Paused | Stopping | Aborting)
    }

    /// Whether the job is over for good.
    pub fn is_final(self) -> bool {
        use JobState::{Aborted, Completed, Failed, Stopped};
        matches!(self, Completed | Stopped | Aborted | Failed)
    }

    /// The state's name as users see it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Checking => "checking",
            Self::Printing => "printing",
            Self::Pausing => "pausing",
            Self::Paused => "paused",
            Self::Stopping => "stopping",
            Self::Aborting => "aborting",
            Self::Completed => "completed",
            Self::Stopped => "stopped",
            Self::Aborted => "aborted",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
        }
    }
}

impl std::fmt::Display for JobState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
