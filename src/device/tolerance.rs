//! How far what a device reports may be from what was commanded. `docs/protocol.md` states the same figures.

/// Timers of firmware tick every millisecond to ten; two ticks at either end.
const EXPOSURE_TOLERANCE_MS: u32 = 20;
/// The clock of a simple microcontroller may be wrong by this share.
const EXPOSURE_TOLERANCE_PERCENT: u32 = 2;

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
        let share_ms = u64::from(commanded_ms) * u64::from(EXPOSURE_TOLERANCE_PERCENT) / 100;
        let tolerance_ms = share_ms.max(u64::from(EXPOSURE_TOLERANCE_MS));
        if u64::from(commanded_ms.abs_diff(reported_ms)) <= tolerance_ms {
            return Self::Right;
        }
        if reported_ms < commanded_ms { Self::TooLittle } else { Self::TooMuch }
    }
}
