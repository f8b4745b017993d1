//! What the daemon takes from its host: a log, clocks, and systemd's attention. `start/run.rs` sets it up.

pub(crate) mod clock;
pub(crate) mod log;
pub(crate) mod notify;
