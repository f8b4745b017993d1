//! The machine's own clock, which may run at another rate than the simulation's while a lie lasts.

/// A rate in percent that means the right one.
const RIGHT_PERCENT: u64 = 100;

/// Converts between the simulation's time and the machine's. Both are microseconds and ascend.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    base_us: u64,
    base_machine_us: u64,
    /// True time that passes while 100 of the machine's pass.
    percent: u64,
}

impl Clock {
    /// A right clock.
    pub(super) fn new() -> Self {
        Self { base_us: 0, base_machine_us: 0, percent: RIGHT_PERCENT }
    }

    /// What it shows. `now_us` is not before the last [`Self::set_rate`].
    pub(super) fn machine_us(&self, now_us: u64) -> u64 {
        self.base_machine_us + (now_us - self.base_us) * RIGHT_PERCENT / self.percent
    }

    /// The first time at which it shows that or more.
    pub(super) fn true_us(&self, machine_us: u64) -> u64 {
        let machine_us = machine_us.saturating_sub(self.base_machine_us);
        self.base_us + (machine_us * self.percent).div_ceil(RIGHT_PERCENT)
    }

    /// Changes its rate; what it shows does not jump.
    pub(super) fn set_rate(&mut self, percent: u32, now_us: u64) {
        let machine_us = self.machine_us(now_us);
        *self = Self { base_us: now_us, base_machine_us: machine_us, percent: u64::from(percent.max(1)) };
    }

    pub(super) fn is_right(&self) -> bool {
        self.percent == RIGHT_PERCENT
    }

    /// Makes the rate right.
    pub(super) fn correct(&mut self, now_us: u64) {
        if !self.is_right() {
            self.set_rate(RIGHT_PERCENT as u32, now_us);
        }
    }
}
