//! Results of work in the background, for the printer's loop: disk, computation, whatever may block.
//! `printer/event_loop.rs` takes them in.

use std::sync::Arc;

use crate::daemon::error::OrderError;
use crate::daemon::handle::Reply;
use crate::daemon::jobs::job::Job;
use crate::daemon::jobs::opened::{Opened, Unopened};
use crate::daemon::jobs::resin::Resin;
use crate::daemon::jobs::settle::Settled;

/// Result of work in the background.
#[derive(Debug)]
pub(crate) enum Background {
    /// A record was written to a journal, or not.
    Journalled {
        /// The job.
        job: u32,
        /// Why not.
        result: Result<(), String>,
    },
    /// A job was opened, now that its turn has come.
    Opened {
        /// The job.
        job: u32,
        /// All it needs, or why it cannot be printed.
        result: Result<Box<Opened>, Unopened>,
    },
    /// A new job is in the spool, or not.
    Accepted {
        /// The job.
        result: Result<Box<Job>, OrderError>,
        /// Jobs that had ended when the operator asked.
        jobs_ended: u64,
        /// Who asked.
        reply: Reply,
        /// Shows that the submission is not answered yet.
        under_way: Arc<()>,
    },
    /// The part of a job was sampled, or why not.
    Sampled {
        /// The job.
        job: u32,
        /// About how much resin it takes, or why that is not known.
        result: Result<Resin, String>,
    },
    /// A change was checked against a waiting job's journal and written there, or refused.
    Changed {
        /// The job.
        job: u32,
        /// The change.
        result: Result<Settled, OrderError>,
        /// Who asked.
        reply: Reply,
    },
    /// The journals that could not be read were tried again.
    ReadAgain {
        /// The jobs whose journals can be read now.
        jobs: Vec<Job>,
    },
    /// A finished job was deleted, or not.
    Removed {
        /// The job.
        job: u32,
        /// Bytes that became free, or what could not be deleted.
        result: Result<u64, String>,
        /// Who asked.
        reply: Reply,
    },
    /// The spool's note of a raised plate was written, or why not.
    RaisedNoted {
        /// The height in it.
        from_um: Option<i32>,
        /// Why it was not written.
        result: Result<(), String>,
    },
    /// The job that ended has given its memory back, and the oldest jobs were deleted from the spool.
    Released {
        /// Jobs whose records were deleted, or why that failed.
        forgotten: Result<Vec<u32>, String>,
    },
}
