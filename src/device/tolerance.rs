//! How far what a device reports may be from what was commanded. `docs/protocol.md` states the same figures.

/// Timers of firmware tick every millisecond to ten; two ticks at either end.
const TIMER_TOLERANCE_MS: u32 = 20;
/// The clock of a simple microcontroller may be wrong by this share.
const EXPOSURE_TOLERANCE_PERCENT: u32 = 2;
/// A move may take less time than distance and speed say by this share: the clock, and speeds rounded to whole steps a tick.
const MOVE_TOLERANCE_PERCENT: u64 = 10;

/// Time that must pass between the order to expose and the device's word that it did, microseconds of the device's clock: the
/// commanded time less the tolerance of [`Dose::of`].
pub fn least_exposure_us(commanded_ms: u32) -> u64 {
    (u64::from(commanded_ms)).saturating_sub(exposure_tolerance_ms(commanded_ms)) * 1000
}

/// Time that must pass between the order to move and the device's word that it did, microseconds of the device's clock: distance
/// by speed, less 10 % or 20 ms, the larger of the two. A `speed_um_s` of 0 counts as 1.
pub fn least_move_us(distance_um: u32, speed_um_s: u32) -> u64 {
    let travel_us = u64::from(distance_um) * 1_000_000 / u64::from(speed_um_s.max(1));
    let tolerance_us = (travel_us * MOVE_TOLERANCE_PERCENT / 100).max(u64::from(TIMER_TOLERANCE_MS) * 1000);
    travel_us.saturating_sub(tolerance_us)
}

/// What a time with light may differ from the commanded one, milliseconds.
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
    /// Compares times with light, milliseconds. The tolerance is 20 ms or 2 % of the commanded time, the larger of the two.
    pub fn of(commanded_ms: u32, reported_ms: u32) -> Self {
        if u64::from(commanded_ms.abs_diff(reported_ms)) <= exposure_tolerance_ms(commanded_ms) {
            return Self::Right;
        }
        if reported_ms < commanded_ms { Self::TooLittle } else { Self::TooMuch }
    }
}
