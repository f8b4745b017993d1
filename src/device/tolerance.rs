//! Tolerances between reported and commanded values. `docs/protocol.md` states the same figures.
//!
//! ```
//! use layerd::device::{Dose, least_exposure_us};
//!
//! // 2 % of two seconds.
//! assert_eq!(Dose::of(2000, 1960), Dose::Right);
//! assert_eq!(Dose::of(2000, 1959), Dose::TooLittle);
//! assert_eq!(least_exposure_us(2000), 1_960_000);
//! ```

/// Firmware timers tick every 1 to 10 ms; this allows two ticks.
const TIMER_TOLERANCE_MS: u32 = 20;
/// Error of the clock of a simple microcontroller.
const EXPOSURE_TOLERANCE_PERCENT: u32 = 2;
/// A move may be this much faster than distance by speed: clock error, and speeds rounded to whole steps per tick.
const MOVE_TOLERANCE_PERCENT: u64 = 10;

/// Converts a duration of the device's clock to the host's clock, microseconds. `time_scale` is
/// [`crate::config::Machine::time_scale`].
pub fn host_us(device_us: u64, time_scale: f64) -> u64 {
    (device_us as f64 / time_scale) as u64
}

/// Least time between the order to expose and the report that the exposure ended, microseconds of the device's clock: the commanded
/// time less the tolerance of [`Dose::of`].
pub fn least_exposure_us(commanded_ms: u32) -> u64 {
    (u64::from(commanded_ms)).saturating_sub(exposure_tolerance_ms(commanded_ms)) * 1000
}

/// Least time between the order to move and the report that the move ended, microseconds of the device's clock: distance by speed,
/// less 10 % or 20 ms, the larger of the two. A `speed_um_s` of 0 counts as 1.
pub fn least_move_us(distance_um: u32, speed_um_s: u32) -> u64 {
    let travel_us = u64::from(distance_um) * 1_000_000 / u64::from(speed_um_s.max(1));
    let tolerance_us = (travel_us * MOVE_TOLERANCE_PERCENT / 100).max(u64::from(TIMER_TOLERANCE_MS) * 1000);
    travel_us.saturating_sub(tolerance_us)
}

/// Tolerance of a light time, milliseconds.
fn exposure_tolerance_ms(commanded_ms: u32) -> u64 {
    let share_ms = u64::from(commanded_ms) * u64::from(EXPOSURE_TOLERANCE_PERCENT) / 100;
    share_ms.max(u64::from(TIMER_TOLERANCE_MS))
}

/// How a reported exposure compares with the commanded one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dose {
    /// Less light than commanded, beyond the tolerance.
    TooLittle,
    /// As commanded.
    Right,
    /// More light than commanded, beyond the tolerance.
    TooMuch,
}

impl Dose {
    /// Compares light times, milliseconds. The tolerance is 20 ms or 2 % of the commanded time, the larger of the two.
    pub fn of(commanded_ms: u32, reported_ms: u32) -> Self {
        if u64::from(commanded_ms.abs_diff(reported_ms)) <= exposure_tolerance_ms(commanded_ms) {
            return Self::Right;
        }
        if reported_ms < commanded_ms { Self::TooLittle } else { Self::TooMuch }
    }
}
