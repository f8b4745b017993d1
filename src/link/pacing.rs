//! Limits how far ahead of the line bytes are given to the kernel, and measures how busy the line is.
//!
//! An urgent frame waits behind all bytes in the kernel's buffer. So the buffer is filled at the rate of the line, not up to its
//! size. [`driver`](super::driver) uses it.

use layerd_wire::session::line_time_us;

/// Line time of the bytes given to the kernel ahead. Short, because an urgent frame waits behind them; long enough that the line
/// does not run dry while the host is busy.
const BACKLOG_US: u64 = 10_000;

/// The pacing of one line. Times are microseconds of a monotonic clock.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pacing {
    baud: u32,
    /// When the kernel's bytes will have been sent.
    busy_until_us: u64,
    seen_us: u64,
    had_data: bool,
    wanted_us: u64,
    busy_us: u64,
}

impl Pacing {
    /// An idle line of this rate.
    pub(super) fn new(baud: u32) -> Self {
        Self { baud, busy_until_us: 0, seen_us: 0, had_data: false, wanted_us: 0, busy_us: 0 }
    }

    /// The port was reopened: the kernel's buffer is empty.
    pub(super) fn reset(&mut self) {
        self.busy_until_us = 0;
    }

    /// When the kernel may have the next frame.
    pub(super) fn free_us(&self) -> u64 {
        self.busy_until_us.saturating_sub(BACKLOG_US)
    }

    /// The kernel took bytes.
    pub(super) fn sent(&mut self, bytes: usize, now_us: u64) {
        self.busy_until_us = self.busy_until_us.max(now_us) + line_time_us(bytes, self.baud);
    }

    /// Counts the time since the last call; `has_data` says whether anything waits for the line from now on.
    pub(super) fn count(&mut self, has_data: bool, now_us: u64) {
        if self.had_data {
            self.wanted_us += now_us.saturating_sub(self.seen_us);
            self.busy_us += now_us.min(self.busy_until_us).saturating_sub(self.seen_us);
        }
        self.seen_us = now_us;
        self.had_data = has_data;
    }

    /// Share of the time with data to send during which the line was busy, 0 to 1; `None` before any data.
    pub(super) fn busy_share(&self) -> Option<f64> {
        (self.wanted_us > 0).then(|| self.busy_us as f64 / self.wanted_us as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_stands_still_with_data_waiting_is_not_busy() {
        let mut pacing = Pacing::new(10_000_000);
        pacing.count(true, 0);
        assert_eq!(pacing.busy_share(), None);
        pacing.sent(30_000, 0);
        assert_eq!(pacing.free_us(), 20_000);
        pacing.count(true, 10_000);
        assert_eq!(pacing.busy_share(), Some(1.0));
        pacing.count(false, 60_000);
        assert_eq!(pacing.busy_share(), Some(0.5));
        pacing.count(true, 1_000_000);
        assert_eq!(pacing.busy_share(), Some(0.5), "idle time without data does not count");
    }
}
