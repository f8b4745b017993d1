//! The life of a job: its states, its journal, and the engine that decides what happens next.
//!
//! [`Engine`] does no I/O and reads no clock: the daemon carries its [`Action`]s out and tells it what happens.

mod engine;
mod event;
mod plan;
mod record;
mod state;

pub use engine::Engine;
pub use event::{Action, Command, Event, Progress};
pub use plan::JobPlan;
pub use record::{Contradiction, History, Record, ResumeChoice, ResumeError, StartPoint, Unconfirmed};
pub use state::JobState;
