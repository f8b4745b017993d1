//! What the daemon takes from its host: a log, clocks, and notifications to systemd. `start/run.rs` sets it up.

pub(crate) mod clock;
pub(crate) mod log;
pub(crate) mod notify;
