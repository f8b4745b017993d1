//! The records of a journal. [`History::replay`](super::History::replay) computes the state that follows from them; see there.
//!
//! Exposures are numbered as in [`Passes`]. In a part of one material that is the number of the layer.

use bincode::{Decode, Encode};
use serde::{Deserialize, Serialize};

use super::JobState;
use crate::device::Passes;

/// One fact. A record that announces an act is on disk before the act begins.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub enum Record {
    /// The job was accepted. Always the first record.
    Accepted {
        /// Identifies the job's exposures to the device: random, never 0.
        key: u64,
        /// Number of layers.
        layer_count: u32,
        /// Name of the part, for people.
        name: String,
    },
    /// An engine took over the job. The layers from this one on are still to be exposed.
    Started {
        /// The next exposure.
        exposure: u32,
    },
    /// This layer's exposure is about to be commanded.
    Commanded {
        /// The exposure.
        exposure: u32,
        /// [`crate::link::message::DeviceState::boot_id`] of the device it is commanded to.
        boot_id: u32,
    },
    /// The device exposed the layer for its whole time.
    Confirmed {
        /// The exposure.
        exposure: u32,
    },
    /// The layer was commanded, and the device says that it did not expose it. Nothing else shows that it had no light.
    NotExposed {
        /// The exposure.
        exposure: u32,
    },
    /// The layer was commanded, and it is unknown how much light it had.
    InDoubt {
        /// The exposure.
        exposure: u32,
        /// What is known.
        why: String,
    },
    /// The operator decided on a layer in doubt.
    Decided {
        /// The exposure.
        exposure: u32,
        /// Whether it counts as exposed; otherwise it is exposed again.
        exposed: bool,
    },
    /// The job rests, with its machine parked if it can be.
    Paused,
    /// Printing goes on after a pause.
    Resumed,
    /// The device confirmed that its light is off after an abort.
    LightOff,
    /// The engine has ended the job.
    Ended {
        /// The last state.
        state: JobState,
        /// Why.
        reason: String,
    },
    /// The operator ordered the end of the job. It never prints again, not even after a restart.
    Ordered(EndOrder),
    /// Written before the first downward move of a job without light: the plate is empty, or the operator confirmed that it is.
    PlateClear {
        /// [`crate::link::message::DeviceState::boot_id`] of the device.
        boot_id: u32,
        /// Exposures shown by that device and unknown to this spool. The operator has confirmed them.
        traces: Vec<Trace>,
    },
    /// The machine is parked: the part is safe. Written before [`Record::Ended`].
    Parked,
    /// The layer was to be commanded, but the order never left the host: it certainly had no light.
    Withdrawn {
        /// The exposure.
        exposure: u32,
    },
    /// The last record was damaged when the journal was opened to be continued, and was dropped.
    Dropped {
        /// Which record, and where.
        what: String,
    },
    /// What the device had exposed last, of another job, when this job's first layer was about to be commanded. If it names anything
    /// else of another job later, that job was printed since.
    LastExposed {
        /// Key of the job.
        job: u64,
        /// The layer.
        layer: u32,
    },
    /// The layer was commanded, and the device exposed it up to this vector. It goes on there.
    PartlyMarked {
        /// The exposure.
        exposure: u32,
        /// The first vector that is not marked.
        next_vector: u32,
    },
    /// Follows [`Record::Accepted`] if the part is of several materials: which exposures its layers have.
    Passes(Passes),
    /// As [`Record::LastExposed`], of a later exposure of a layer.
    LastExposedPass {
        /// Key of the job.
        job: u64,
        /// The layer.
        layer: u32,
        /// Number of the exposure within the layer.
        pass: u8,
    },
}

impl Record {
    /// The exposure that it tells of.
    pub fn exposure(&self) -> Option<u32> {
        match self {
            Self::Started { exposure }
            | Self::Commanded { exposure, .. }
            | Self::Confirmed { exposure }
            | Self::NotExposed { exposure }
            | Self::PartlyMarked { exposure, .. }
            | Self::Withdrawn { exposure }
            | Self::InDoubt { exposure, .. }
            | Self::Decided { exposure, .. } => Some(*exposure),
            Self::Accepted { .. }
            | Self::Passes(_)
            | Self::Paused
            | Self::Resumed
            | Self::PlateClear { .. }
            | Self::LastExposed { .. }
            | Self::LastExposedPass { .. }
            | Self::Dropped { .. }
            | Self::LightOff
            | Self::Ordered(_)
            | Self::Parked
            | Self::Ended { .. } => None,
        }
    }

    /// Whether the record tells of an end, or of something that has already happened. Such a record may use the reserved space of
    /// the journal; a record that begins something may not.
    pub fn is_last(&self) -> bool {
        match self {
            Self::Accepted { .. }
            | Self::Started { .. }
            | Self::Commanded { .. }
            | Self::Paused
            | Self::Resumed
            | Self::PlateClear { .. }
            | Self::LastExposed { .. }
            | Self::LastExposedPass { .. }
            | Self::Passes(_)
            | Self::Dropped { .. } => false,
            Self::Confirmed { .. }
            | Self::NotExposed { .. }
            | Self::PartlyMarked { .. }
            | Self::Withdrawn { .. }
            | Self::InDoubt { .. }
            | Self::Decided { .. }
            | Self::LightOff
            | Self::Ordered(_)
            | Self::Parked
            | Self::Ended { .. } => true,
        }
    }
}

/// How the operator ordered a job to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Encode, Decode)]
#[serde(rename_all = "lowercase")]
pub enum EndOrder {
    /// After the layer under way.
    Stop,
    /// At once; the light goes off first.
    Abort,
}

impl EndOrder {
    /// The order as the operator types it.
    pub fn verb(self) -> &'static str {
        match self {
            Self::Stop => "stop",
            Self::Abort => "abort",
        }
    }
}

/// A trace of an exposure in a device's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Encode, Decode)]
pub enum Trace {
    /// It had light: exposed, cut short, or still under way.
    Lit {
        /// Key of the job.
        job: u64,
        /// The layer.
        layer: u32,
    },
    /// It is in one of the device's slots.
    Held {
        /// Key of the job.
        job: u64,
        /// The layer.
        layer: u32,
    },
}

/// An exposure that was commanded and neither confirmed nor denied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unconfirmed {
    /// Number of the exposure.
    pub exposure: u32,
    /// Boot id of the device that it was commanded to.
    pub boot_id: u32,
}
