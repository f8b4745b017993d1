//! A deadline for an answer. If the host itself stood still (SIGSTOP, suspend, overload), the deadline is extended, so that the host
//! can first read the answers that arrived in the meantime. `device/driver/framed.rs` and `job/engine` wait for answers with it.

/// If a deadline is noticed this late, the host stood still. A loaded machine is some 10 ms late.
const STANDSTILL_US: u64 = 500_000;
/// Extension after a standstill: time to read what is in the port's buffer.
const READING_US: u64 = 1_000_000;

/// A point in time by which an answer is due. Times are microseconds of a monotonic clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Deadline {
    at_us: u64,
    /// It was extended after a standstill, which happens only once.
    extended: bool,
}

impl Deadline {
    /// A deadline at that time.
    pub(crate) fn at(at_us: u64) -> Self {
        Self { at_us, extended: false }
    }

    /// When to call [`Self::is_over`] next.
    pub(crate) fn at_us(self) -> u64 {
        self.at_us
    }

    /// Moves the deadline to `at_us` if it is later.
    pub(crate) fn no_later_than(&mut self, at_us: u64) {
        self.at_us = self.at_us.min(at_us);
    }

    /// Whether the deadline has passed. If the host notices it much too late, the host stood still, and the deadline is extended
    /// once.
    pub(crate) fn is_over(&mut self, now_us: u64) -> bool {
        if now_us < self.at_us {
            return false;
        }
        if self.extended || now_us < self.at_us.saturating_add(STANDSTILL_US) {
            return true;
        }
        *self = Self { at_us: now_us + READING_US, extended: true };
        false
    }
}
