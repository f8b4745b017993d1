//! The daemon's two clocks: a monotonic one for decisions, and the wall clock for people.
//! `printer/event_loop.rs` decides by the one and journals with the other.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

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
    pub(crate) fn at(self, time_us: u64) -> tokio::time::Instant {
        tokio::time::Instant::from_std(self.start + Duration::from_micros(time_us))
    }
}

/// Unix time in milliseconds; 0 if the wall clock is before 1970.
pub(crate) fn unix_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}
