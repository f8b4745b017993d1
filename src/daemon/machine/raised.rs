//! The note that the plate was raised from below its clear height: kept in memory and, for the next process, in the spool.
//! `tests/plate.rs` shows it after a restart.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::mpsc;

use crate::daemon::background::Background;
use crate::job::Spool;
use crate::system::spawn_blocking;

/// Pause before a note that could not be written is tried again: a full disk may get room at any time, and a failed try
/// writes nothing to the log.
const RETRY_US: u64 = 10_000_000;

/// The note.
#[derive(Debug)]
pub(crate) struct RaisedNote {
    /// Height from which the plate was raised, micrometres. `None` once it is known to be empty.
    from_um: Option<i32>,
    /// Whether the spool holds `from_um`.
    is_written: bool,
    /// Whether a write is under way. One at a time, so that none overtakes another.
    is_writing: bool,
    /// Whether the operator was told that `from_um` could not be written.
    is_told: bool,
    /// A write that failed is tried again then.
    retry_us: u64,
}

impl RaisedNote {
    /// The note of an earlier process. If it cannot be read, the plate counts as raised: the operator must look.
    pub(crate) fn load(spool: &Spool) -> Self {
        let from_um = spool.raised_from_um().unwrap_or_else(|error| {
            tracing::warn!("{error}; the plate is assumed to have been raised with a part on it");
            Some(0)
        });
        Self { from_um, is_written: true, is_writing: false, is_told: false, retry_us: 0 }
    }

    /// Height from which the plate was raised, micrometres.
    pub(crate) fn height_um(&self) -> Option<i32> {
        self.from_um
    }

    /// Whether the spool holds this note.
    pub(crate) fn is_written(&self) -> bool {
        self.is_written
    }

    /// Whether it is time to try again a write that failed.
    pub(crate) fn is_due(&self, now_us: u64) -> bool {
        now_us >= self.retry_us
    }

    /// Changes the height; returns whether it is another. The caller then writes the note.
    pub(crate) fn set(&mut self, from_um: Option<i32>) -> bool {
        let changes = self.from_um != from_um;
        if changes {
            (self.from_um, self.is_written, self.is_told) = (from_um, false, false);
        }
        changes
    }

    /// Writes the note in the background, unless the spool holds it or a write is under way. [`Background::RaisedNoted`] reports
    /// the result.
    pub(crate) fn write(&mut self, spool: &Arc<Mutex<Spool>>, background: &mpsc::Sender<Background>) {
        if self.is_writing || self.is_written {
            return;
        }
        self.is_writing = true;
        let (spool, from_um, background) = (Arc::clone(spool), self.from_um, background.clone());
        spawn_blocking(move || {
            let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
            let result = spool.set_raised(from_um).map_err(|error| error.to_string());
            let _ = background.blocking_send(Background::RaisedNoted { from_um, result });
        });
    }

    /// Takes the end of a write; returns whether it was of the present height. If not, the caller writes again.
    pub(crate) fn ended(&mut self, from_um: Option<i32>, is_written: bool, now_us: u64) -> bool {
        self.is_writing = false;
        let is_present = from_um == self.from_um;
        if is_present {
            self.is_written = is_written;
            self.retry_us = now_us + RETRY_US;
        }
        is_present
    }

    /// Whether the operator must be told now that the note could not be written: once for each height.
    pub(crate) fn must_tell(&mut self) -> bool {
        !std::mem::replace(&mut self.is_told, true)
    }
}
