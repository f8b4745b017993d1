//! A deadline for somebody else's answer that is judged fairly: a host that stood still (SIGSTOP, suspend, a stalled machine) first
//! reads what has been said meanwhile.

/// A deadline noticed this much too late shows that the host stood still. A loaded machine is some 10 ms late.
const STANDSTILL_US: u64 = 500_000;
/// After a standstill, what lies unread in the port's buffer reaches its reader within this time.
const READING_US: u64 = 1_000_000;

/// A point in time by which an answer is due. Times are microseconds of any clock that never goes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Deadline {
    at_us: u64,
    /// It was extended after a standstill; that happens once.
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

    /// Brings the deadline forward, where it is later than that time.
    pub(crate) fn no_later_than(&mut self, at_us: u64) {
        self.at_us = self.at_us.min(at_us);
    }

    /// Whether the time is over. Where the host notices only long after the deadline, it was the host that stood still: the
    /// deadline is extended, once.
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
