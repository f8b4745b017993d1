//! The life of a job: its states, its journal, and the engine that decides what happens next.
//!
//! [`Engine`] does no I/O and reads no clock: the daemon carries out its [`Action`]s and passes it [`Event`]s.

mod engine;
mod event;
mod fate;
mod history;
mod journal;
mod plan;
mod record;
mod spool;
mod state;

pub use engine::{ACT_MARGIN_US, Engine};
pub use event::{Action, Command, Event, Progress};
pub use fate::{Fate, fate};
pub use history::{Contradiction, History, ResumeChoice, ResumeError, StartPoint};
pub use journal::{Entry, Journal, JournalError, read_journal};
pub use plan::JobPlan;
pub use record::{EndOrder, Record, Trace, Unconfirmed};
pub use spool::{
    Forgotten, JobDirectory, MAX_FORGOTTEN, MAX_PARTS, MAX_RECORDS, NewJob, PlateAfter, Spool, SpoolError,
};
pub use state::JobState;
