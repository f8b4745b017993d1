//! The daemon's clock for decisions; `printer/event_loop.rs` decides by it. It is tokio's, so that a simulation can pause it and move
//! it on. The wall clock, for people, is in `system`.

use std::time::Duration;

use tokio::time::Instant;

/// Microseconds since the daemon's start; monotonic.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    start: Instant,
}

impl Clock {
    /// A clock that starts now.
    pub(crate) fn new() -> Self {
        Self { start: Instant::now() }
    }

    /// Now.
    pub(crate) fn now_us(self) -> u64 {
        u64::try_from(self.start.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    /// The time as tokio's instant.
    pub(crate) fn at(self, time_us: u64) -> Instant {
        self.start + Duration::from_micros(time_us)
    }
}
