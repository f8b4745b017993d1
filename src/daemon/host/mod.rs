//! What the daemon takes from its host: a log, clocks, and systemd's attention.

pub(crate) mod clock;
pub(crate) mod log;
pub(crate) mod notify;
