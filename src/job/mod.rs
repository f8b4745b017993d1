//! The life of a job: its states, its journal, and the engine that decides what happens next. No I/O, no clock.

mod state;

pub use state::JobState;
