//! Pauses between sessions, so that a device that fails every session does not flood the log and the events.
//! [`driver`](super::driver) uses it.

/// Pause after a session that failed: short at first, since a device that restarts is back soon.
const FIRST_PAUSE_US: u64 = 100_000;
/// Longest pause. A device that is switched on again is found within this time.
const MAX_PAUSE_US: u64 = 5_000_000;
/// A session that lasted this long was good: the next pause is short again.
const STEADY_US: u64 = MAX_PAUSE_US;
/// Sessions the owner may begin in a row without a pause. A job needs one at its beginning, after an abort and at its end.
const BURST: u64 = 6;
/// After a burst, one session per this time.
const REFILL_US: u64 = 1_000_000;

/// The pauses of one line. Times are microseconds of a monotonic clock.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spacing {
    pause_us: u64,
    /// When the present session was accepted.
    connected_us: Option<u64>,
    /// The burst is used up to this time. Each session moves it by [`REFILL_US`].
    used_until_us: u64,
}

impl Spacing {
    /// Nothing has begun yet.
    pub(super) fn new() -> Self {
        Self { pause_us: FIRST_PAUSE_US, connected_us: None, used_until_us: 0 }
    }

    /// The device accepted the session.
    pub(super) fn connected(&mut self, now_us: u64) {
        self.connected_us = Some(now_us);
    }

    /// A session, or an attempt to open the port, failed. Returns the pause before the next, microseconds.
    pub(super) fn failed(&mut self, now_us: u64) -> u64 {
        if self.connected_us.take().is_some_and(|since_us| now_us.saturating_sub(since_us) >= STEADY_US) {
            self.pause_us = FIRST_PAUSE_US;
        }
        let pause_us = self.pause_us;
        self.pause_us = (2 * pause_us).min(MAX_PAUSE_US);
        pause_us
    }

    /// The owner asks for a new session. Returns the pause before it, microseconds: 0 unless it asks too often.
    pub(super) fn renewed(&mut self, now_us: u64) -> u64 {
        self.connected_us = None;
        self.used_until_us = self.used_until_us.max(now_us) + REFILL_US;
        self.used_until_us.saturating_sub(now_us + BURST * REFILL_US)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_until_a_session_lasts() {
        let mut spacing = Spacing::new();
        let mut pauses = Vec::new();
        let mut now_us = 0;
        for _ in 0..8 {
            spacing.connected(now_us);
            now_us += STEADY_US - 1;
            pauses.push(spacing.failed(now_us) / 1000);
        }
        assert_eq!(pauses, [100, 200, 400, 800, 1600, 3200, 5000, 5000], "a short session is no success");
        spacing.connected(now_us);
        assert_eq!(spacing.failed(now_us + STEADY_US), FIRST_PAUSE_US);
        assert_eq!(spacing.failed(now_us + 2 * STEADY_US), 2 * FIRST_PAUSE_US, "one that never stood is none, either");
    }

    #[test]
    fn a_few_sessions_asked_for_begin_at_once_and_more_of_them_once_a_second() {
        let mut spacing = Spacing::new();
        let now_us = 1_000_000_000;
        let pauses: Vec<u64> = (0..9).map(|_| spacing.renewed(now_us) / 1000).collect();
        assert_eq!(pauses, [0, 0, 0, 0, 0, 0, 1000, 2000, 3000]);
        assert_eq!(spacing.renewed(now_us + 20_000_000), 0, "time refills the burst");
    }
}
