//! The retransmission timer of RFC 6298, with bounds for a serial line. [`Endpoint`](super::Endpoint) uses it.

/// Granularity of the owner's clock (G in RFC 6298).
const GRANULARITY_US: u64 = 1_000;
/// Allowance for scheduling on a busy host, in addition to the time of the line.
const MIN_US: u64 = 25_000;
/// A quarter of the dead-man time: a sender tries several times before the session is lost. It is above the floor, which is at most
/// 275 ms (see the window's limit in the endpoint).
const MAX_US: u64 = 500_000;

/// Smoothed round trip and time-out.
#[derive(Debug)]
pub(super) struct RetransmitTimer {
    smoothed_us: Option<u64>,
    variation_us: u64,
    floor_us: u64,
    timeout_us: u64,
}

impl RetransmitTimer {
    /// `window_time_us` is the line time of a full window. A shorter time-out would be wrong.
    pub(super) fn new(window_time_us: u64) -> Self {
        let floor_us = (MIN_US + window_time_us).min(MAX_US);
        // Before the first sample RFC 6298 takes one second, for the internet. Twice the floor is ample for a cable.
        Self { smoothed_us: None, variation_us: 0, floor_us, timeout_us: (2 * floor_us).min(MAX_US) }
    }

    pub(super) fn timeout_us(&self) -> u64 {
        self.timeout_us
    }

    pub(super) fn smoothed_us(&self) -> u64 {
        self.smoothed_us.unwrap_or(0)
    }

    /// Takes the round trip of a frame that was sent only once (Karn's rule).
    pub(super) fn sample(&mut self, round_trip_us: u64) {
        match self.smoothed_us {
            None => {
                self.smoothed_us = Some(round_trip_us);
                self.variation_us = round_trip_us / 2;
            }
            Some(smoothed) => {
                self.variation_us = (3 * self.variation_us + smoothed.abs_diff(round_trip_us)) / 4;
                self.smoothed_us = Some((7 * smoothed + round_trip_us) / 8);
            }
        }
        self.progress();
    }

    /// New data was acknowledged. Ends the back-off even without a sample: on a lossy line samples are rare.
    pub(super) fn progress(&mut self) {
        let estimate = match self.smoothed_us {
            Some(smoothed) => smoothed + (4 * self.variation_us).max(GRANULARITY_US),
            None => 2 * self.floor_us,
        };
        self.timeout_us = estimate.clamp(self.floor_us, MAX_US);
    }

    /// The timer ran out: doubles the time-out.
    pub(super) fn back_off(&mut self) {
        self.timeout_us = (2 * self.timeout_us).min(MAX_US);
    }
}
