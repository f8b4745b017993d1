//! The note that the plate was raised from below its clear height: kept in memory and, for the next process, in the spool.

use std::sync::{Arc, PoisonError};

use crate::daemon::printer::Printer;
use crate::daemon::printer::background::Background;
use crate::job::Spool;

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
}

impl Printer {
    /// Remembers, here and in the spool, from where the plate was raised; `None` once it is known to be empty.
    pub(crate) fn set_raised(&mut self, from_um: Option<i32>) {
        if self.raised.from_um != from_um {
            (self.raised.from_um, self.raised.is_written, self.raised.is_told) = (from_um, false, false);
            self.write_raised();
        }
    }

    fn write_raised(&mut self) {
        if self.raised.is_writing || self.raised.is_written {
            return;
        }
        self.raised.is_writing = true;
        let (spool, from_um, background) = (Arc::clone(&self.spool), self.raised.from_um, self.background.clone());
        tokio::task::spawn_blocking(move || {
            let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
            let result = spool.set_raised(from_um).map_err(|error| error.to_string());
            let _ = background.blocking_send(Background::RaisedNoted { from_um, result });
        });
    }

    /// Tries again to write a note that could not be written.
    pub(crate) fn retry_raised(&mut self) {
        if self.clock.now_us() >= self.raised.retry_us {
            self.write_raised();
        }
    }

    /// A write has ended. Tells the operator if the spool could not take the note.
    pub(crate) fn raised_noted(&mut self, from_um: Option<i32>, result: Result<(), String>) {
        self.raised.is_writing = false;
        if from_um != self.raised.from_um {
            // It changed meanwhile.
            return self.write_raised();
        }
        self.raised.is_written = result.is_ok();
        self.raised.retry_us = self.clock.now_us() + RETRY_US;
        if let Err(text) = &result
            && !std::mem::replace(&mut self.raised.is_told, true)
        {
            self.notice(format!(
                "the spool cannot record whether the plate was raised with a part on it: {text}. layerd tries again; after a \
                 restart of layerd, look at the plate before the next job"
            ));
        }
        self.raise_noted(result.err());
    }
}
