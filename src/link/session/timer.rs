//! The retransmission timer of RFC 6298, with bounds for a serial line.

/// Granularity of the clock the owner has (RFC 6298's G).
const GRANULARITY_US: u64 = 1_000;
/// Room for scheduling on a busy host, above the time the line itself needs.
const MIN_US: u64 = 25_000;
/// A quarter of the dead-man time: a sender tries several times before the line is given up. Still above the floor, which is
/// at most 275 ms (see the endpoint's bound of the window).
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
    /// `window_time_us`: how long the line needs for a full window; a time-out below it would be false.
    pub(super) fn new(window_time_us: u64) -> Self {
        let floor_us = (MIN_US + window_time_us).min(MAX_US);
        // No sample yet: RFC 6298 takes one second for the internet; twice the floor is ample for a cable.
        Self { smoothed_us: None, variation_us: 0, floor_us, timeout_us: (2 * floor_us).min(MAX_US) }
    }

    pub(super) fn timeout_us(&self) -> u64 {
        self.timeout_us
    }

    pub(super) fn smoothed_us(&self) -> u64 {
        self.smoothed_us.unwrap_or(0)
    }

    /// A round trip of a frame that was sent once (Karn's rule).
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

    /// New data was acknowledged: ends the back-off even without a sample, which a line that loses much seldom gives.
    pub(super) fn progress(&mut self) {
        let estimate = match self.smoothed_us {
            Some(smoothed) => smoothed + (4 * self.variation_us).max(GRANULARITY_US),
            None => 2 * self.floor_us,
        };
        self.timeout_us = estimate.clamp(self.floor_us, MAX_US);
    }

    /// Ran out: doubles.
    pub(super) fn back_off(&mut self) {
        self.timeout_us = (2 * self.timeout_us).min(MAX_US);
    }
}
