//! Pacing: limits the line to its baud rate. [`run`](fn@super::run) uses it, once for each direction.

/// Unused line time is saved up to this much: wake-ups are a few milliseconds late, and that must not cost throughput.
const SAVED_US: u64 = 10_000;

/// Counts what a line may carry: a token bucket of line time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    /// `None`: unlimited.
    baud: Option<u32>,
    /// Line time is used up to here.
    paid_us: u64,
}

impl Pace {
    pub(super) fn new(baud: Option<u32>, now_us: u64) -> Self {
        Self { baud, paid_us: now_us }
    }

    /// Bytes the line can carry now.
    pub(super) fn allowance_bytes(&self, now_us: u64) -> usize {
        let Some(baud) = self.baud else { return usize::MAX };
        // Ten bits a byte: start, eight, stop.
        (now_us.saturating_sub(self.paid_us(now_us)) * u64::from(baud) / 10_000_000) as usize
    }

    fn paid_us(&self, now_us: u64) -> u64 {
        self.paid_us.max(now_us.saturating_sub(SAVED_US))
    }

    /// Takes bytes from the allowance.
    pub(super) fn take(&mut self, bytes: usize, now_us: u64) {
        if let Some(baud) = self.baud {
            self.paid_us = self.paid_us(now_us) + (bytes as u64 * 10_000_000).div_ceil(u64::from(baud));
        }
    }

    /// When the line can carry a few bytes: a millisecond's worth, so that the process does not wake for each byte.
    pub(super) fn next_us(&self) -> u64 {
        let Some(baud) = self.baud else { return 0 };
        self.paid_us + (10_000_000 / u64::from(baud)).max(1000) + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_carries_its_rate_and_no_more_whatever_the_steps() {
        for baud in [9600, 115_200, 3_000_000] {
            let (mut pace, mut carried) = (Pace::new(Some(baud), 0), 0);
            let mut now_us = 0;
            while now_us < 2_000_000 {
                let bytes = pace.allowance_bytes(now_us);
                pace.take(bytes, now_us);
                carried += bytes;
                now_us = pace.next_us().max(now_us + 1300);
            }
            let expected = baud as usize / 10 * 2;
            assert!(carried <= expected + 20 && carried >= expected * 97 / 100, "{carried} of {expected} at {baud}");
        }
        let idle = Pace::new(Some(115_200), 0);
        assert_eq!(idle.allowance_bytes(60_000_000), 115, "an idle line saves 10 ms at most");
        assert_eq!(Pace::new(None, 0).allowance_bytes(0), usize::MAX);
    }
}
