//! A job's log: the records of its journal, as the API sends them. `tests/control_api/logs.rs` reads one.

use serde::{Deserialize, Serialize};

use super::ErrorBody;
use crate::job::{EndOrder, JobState};

/// A line of `GET /v1/jobs/{id}/log`, which is one JSON object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum LogLine {
    /// An entry of the job's journal.
    Entry(LogEntry),
    /// The last line of a log whose journal cannot be read to its end: why.
    Problem(ErrorBody),
}

/// A record of a job's journal, and when it was written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogEntry {
    /// When, Unix milliseconds.
    pub at_ms: u64,
    /// Which of its materials the exposure is of that it tells of; absent if it tells of none, or the part is of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<String>,
    /// What happened.
    #[serde(flatten)]
    pub record: LogRecord,
}

/// What happened to a job. The API's form of a [`crate::job::Record`]: the journal's own may change without breaking readers, and has
/// fields that mean nothing to them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "record", rename_all = "snake_case")]
pub enum LogRecord {
    /// The daemon accepted the job.
    Accepted {
        /// Name of the job, for people.
        name: String,
        /// Layers of the whole part.
        layers_total: u32,
    },
    /// Its part is of several materials.
    Materials {
        /// Their names.
        names: Vec<String>,
        /// Exposures of the whole part.
        exposures_total: u32,
        /// How often another vat is put in place.
        changes_total: u32,
    },
    /// It took the machine, at first or again.
    Started {
        /// The layer that is next.
        layer: u32,
    },
    /// The plate was empty before the first move of a job without light, or the operator said so.
    PlateClear {
        /// Exposures of unknown jobs that the device showed and the operator confirmed.
        confirmed_exposures: u32,
    },
    /// What the device had exposed last, of another job, when the first layer was about to be commanded.
    LastExposed {
        /// The other job's layer.
        layer: u32,
    },
    /// The exposure of a layer was about to be commanded.
    Commanded {
        /// The layer.
        layer: u32,
    },
    /// The device exposed the layer for its whole time.
    Confirmed {
        /// The layer.
        layer: u32,
    },
    /// The device says that it did not expose the layer.
    NotExposed {
        /// The layer.
        layer: u32,
    },
    /// The device marked the layer up to this vector. It goes on there.
    PartlyMarked {
        /// The layer.
        layer: u32,
        /// The first vector that is not marked.
        next_vector: u32,
    },
    /// The command never left the host.
    Withdrawn {
        /// The layer.
        layer: u32,
    },
    /// It is unknown how much light the layer had.
    InDoubt {
        /// The layer.
        layer: u32,
        /// What is known.
        why: String,
    },
    /// The operator settled a layer in doubt.
    Decided {
        /// The layer.
        layer: u32,
        /// Whether it counts as exposed; otherwise it is exposed again.
        exposed: bool,
    },
    /// The job is paused. The plate is clear of the resin if it could be lifted.
    Paused,
    /// Printing went on after a pause.
    Resumed,
    /// The device confirmed after an abort that its light is off.
    LightOff,
    /// The operator ordered the end of the job.
    Ordered {
        /// How.
        order: EndOrder,
    },
    /// The machine rests, and the part is safe: in a vat, the plate was lifted clear of the resin at the end.
    Parked,
    /// The last record was damaged when the journal was opened to be continued, and was dropped.
    Dropped {
        /// Which record, and where.
        what: String,
    },
    /// The job ended, or was interrupted.
    Ended {
        /// Its state then.
        state: JobState,
        /// Why; empty if there is nothing to say.
        reason: String,
    },
}
