//! What the machine does: motions that begin and end, light, holds, resets and starts.

use super::facts::{Jump, Mark};
use super::gcode::{Modes, Spindle};
use super::machine::{Busy, Machine};
use super::motion::{Block, Ended};
use super::options::AXES;
use super::system::{self, Rare};

/// From `ALARM:3` to the banner.
const ALARM_TO_BANNER_US: [u64; 2] = [500_000, 100_000];
/// From 0x18 at rest to the banner.
pub(super) const RESET_TO_BANNER_US: u64 = 3_000;
/// From power to the banner.
const POWER_TO_BANNER_US: u64 = 300_000;

impl Machine {
    /// The light as it is now.
    pub(super) fn light(&mut self) {
        let running = self.motion.running();
        let is_moving = running.is_some() && !self.motion.is_held();
        let s = match running {
            // Outside laser mode the spindle does not care for motion.
            _ if !self.is_laser() => self.rest_s,
            Some(_) if self.motion.is_held() => 0.0,
            Some(block) => block.s,
            None => self.rest_s,
        };
        self.beam.set(self.now_us, s, is_moving, &mut self.facts);
    }

    /// A motion begins. Until it ends, it is the last entry of marks or jumps.
    pub(super) fn begin_motion(&mut self) {
        let Some(block) = self.motion.running() else { return };
        let from_mm = self.true_place(block.from);
        let to_mm = from_mm;
        let began_us = self.now_us;
        let s = if self.is_laser() { block.s } else { self.rest_s };
        if s > 0.0 {
            let feed_mm_per_min = block.feed_mm_per_min;
            let mark = Mark { from_mm, to_mm, s, feed_mm_per_min, began_us, ended_us: began_us, whole: false };
            self.facts.marks.push(mark);
        } else {
            self.facts.jumps.push(Jump { from_mm, to_mm, began_us, ended_us: began_us, whole: false });
        }
        // M3 goes on burning after a mark, and is dark after a jump.
        if self.is_laser() {
            self.rest_s = if self.spindle == Spindle::Constant { s } else { 0.0 };
        }
        self.light();
    }

    /// Completes the last entry of marks or jumps.
    pub(super) fn close_motion(&mut self, block: &Block, at_mm: [f64; AXES], whole: bool) {
        let at_mm = self.true_place(at_mm);
        let is_mark = if self.is_laser() { block.s > 0.0 } else { self.rest_s > 0.0 };
        let ended = self.now_us;
        if is_mark && let Some(mark) = self.facts.marks.last_mut() {
            (mark.to_mm, mark.ended_us, mark.whole) = (at_mm, ended, whole);
        } else if !is_mark && let Some(jump) = self.facts.jumps.last_mut() {
            (jump.to_mm, jump.ended_us, jump.whole) = (at_mm, ended, whole);
        }
    }

    pub(super) fn end_motion(&mut self) {
        match self.motion.end(self.now_us) {
            None | Some((Ended::Held, _)) => self.light(),
            Some((Ended::Done(block), speed)) => {
                self.close_motion(&block, block.to, true);
                if self.motion.start(self.now_us, speed) {
                    self.begin_motion();
                } else {
                    self.light();
                }
            }
        }
    }

    pub(super) fn hold(&mut self) {
        if self.alarm.is_none() && self.busy_until().is_none() && !self.motion.is_holding() {
            self.motion.hold(self.now_us);
            self.light();
        }
    }

    pub(super) fn resume(&mut self) {
        if !self.motion.is_held() {
            return;
        }
        self.say("[MSG:Restoring spindle]\r\n");
        if self.is_hal() {
            self.say("[MSG:]\r\n");
        }
        let was_between = self.motion.running().is_none();
        if self.motion.resume(self.now_us) && was_between {
            self.begin_motion();
        } else {
            self.light();
        }
    }

    /// Stands still and dark at once. What ran was cut off.
    pub(super) fn stop_all(&mut self) {
        let at = self.stepped(self.motion.at(self.now_us).0);
        if let Some(block) = self.motion.stop(self.now_us) {
            self.close_motion(&block, at, false);
        }
        self.motion.place(at);
        self.parsed = at;
        self.spindle = Spindle::Off;
        self.rest_s = 0.0;
        self.light();
    }

    /// 0x18, or the reset button.
    pub(super) fn reset(&mut self) {
        self.facts.resets_us.push(self.now_us);
        if matches!(self.busy, Busy::Starting { .. }) || self.trouble.is_silent() {
            return;
        }
        self.trouble.reset();
        let is_homing = matches!(self.busy, Busy::Homing { .. });
        let was_moving = (self.motion.running().is_some() && !self.motion.is_held()) || is_homing;
        self.stop_all();
        let is_waiting = self.doing.take().is_some();
        let is_hal = self.is_hal();
        let mut banner_us = RESET_TO_BANNER_US;
        if was_moving {
            self.alarm = Some(if is_homing { 6 } else { 3 });
            self.needs_homing |= is_hal && self.number(22) as u32 & 4 != 0;
            self.say(if is_homing { "ALARM:6\r\n" } else { "ALARM:3\r\n" });
            banner_us = ALARM_TO_BANNER_US[usize::from(is_hal)];
        }
        // On 1.1 the line that was being done is still answered. A host must not count that answer.
        if (is_waiting || self.is_locked_until_reset) && !is_hal {
            self.say("ok\r\n");
        }
        self.begin_start(banner_us);
    }

    pub(super) fn begin_start(&mut self, banner_us: u64) {
        self.busy = Busy::Starting { until_us: self.now_us + banner_us };
        self.is_locked_until_reset = false;
        self.is_checking = false;
        self.wants_status = false;
    }

    /// What is new at each start, and the banner.
    pub(super) fn start(&mut self) {
        self.modes = Modes::new();
        if !self.is_hal() {
            self.g92 = [0.0; AXES];
        }
        self.buffer.clear();
        self.line.clear();
        (self.comment, self.is_too_long, self.ended_by) = (None, false, 0);
        self.doing = None;
        self.sticky_error = 0;
        self.rare = Rare::new(self.options.firmware);
        self.reported_us = None;
        self.say(system::banner(self.options.firmware));
        if self.needs_homing && self.is_hal() {
            self.say("ALARM:11\r\n[MSG:Homing cycle required]\r\n");
        } else if self.alarm.is_some() {
            self.say("[MSG:'$H'|'$X' to unlock]\r\n");
        }
    }

    /// Power comes on: the machine is where it is, and calls that zero.
    pub(super) fn power_on(&mut self, banner_us: u64) {
        let homing = self.number(22) as u32;
        let is_hal = self.is_hal();
        self.needs_homing = is_hal && homing & 4 != 0;
        self.alarm = (self.needs_homing || (!is_hal && homing != 0)).then_some(11);
        self.is_homed = false;
        self.g92 = [0.0; AXES];
        self.origin = self.true_place(self.motion.at(self.now_us).0);
        self.motion.place([0.0; AXES]);
        self.parsed = [0.0; AXES];
        self.begin_start(banner_us);
    }

    pub(super) fn lose_power(&mut self) {
        self.stop_all();
        self.doing = None;
        self.power_on(POWER_TO_BANNER_US);
    }
}
