//! The plate of a vat machine: position and moves. Part of [`DeviceCore`].

use super::{ActRecord, DeviceCore};
use crate::link::message::{MachineCapabilities, Refusal, Reply, VatReply};

/// Speed of homing, micrometres a second.
pub(super) const HOMING_SPEED_UM_S: u32 = 20_000;

/// A move under way.
#[derive(Debug)]
pub(super) struct Motion {
    pub(super) number: Option<u32>,
    pub(super) began_us: u64,
    pub(super) arrives_us: u64,
    pub(super) from_um: i32,
    pub(super) to_um: i32,
    pub(super) homing: bool,
}

impl DeviceCore {
    /// Where the plate is in truth, micrometres above the bottom of the vat. Unlike [`state`](Self::state), it tells the position
    /// of a plate that is not homed, too. `now_us` is a time of the device's clock, not before that of the last call.
    pub fn plate_um(&self, now_us: u64) -> i32 {
        self.vat.motion.as_ref().map_or(self.vat.position_um, |motion| motion.position_um(now_us))
    }

    /// Where the motion under way ends, micrometres, and whether it is a homing; `None` while the plate rests.
    pub fn plate_target(&self) -> Option<(i32, bool)> {
        self.vat.motion.as_ref().map(|motion| (motion.to_um, motion.homing))
    }

    /// Somebody moves the plate by hand to a height above the bottom of the vat, micrometres. The device has an encoder and knows
    /// the new position if it was homed. A motion under way holds the plate: then this does nothing and returns `false`.
    pub fn push_plate(&mut self, to_um: i32, now_us: u64) -> bool {
        self.advance(now_us);
        let is_free = self.vat.motion.is_none();
        if is_free {
            self.vat.position_um = to_um;
        }
        is_free
    }

    pub(super) fn begin_move(&mut self, number: u32, position_um: i32, speed_um_s: u32) -> Result<(), Refusal> {
        if !self.vat.homed {
            return Err(Refusal::NotHomed);
        }
        let MachineCapabilities::Vat(vat) = &self.capabilities.machine;
        if speed_um_s == 0 || !(0..=vat.max_position_um).contains(&position_um) {
            return Err(Refusal::BadMove);
        }
        self.begin_motion(number, position_um, speed_um_s, false);
        Ok(())
    }

    pub(super) fn begin_motion(&mut self, number: u32, to_um: i32, speed_um_s: u32, homing: bool) {
        let way_um = u64::from(self.vat.position_um.abs_diff(to_um));
        let arrives_us = self.now_us + way_um * 1_000_000 / u64::from(speed_um_s);
        let (began_us, from_um) = (self.now_us, self.vat.position_um);
        self.vat.motion = Some(Motion { number: Some(number), began_us, arrives_us, from_um, to_um, homing });
        // A move to the present position ends at once.
        self.advance(self.now_us);
    }

    pub(super) fn arrive(&mut self, motion: &Motion) {
        self.vat.position_um = motion.to_um;
        self.vat.homed |= motion.homing;
        self.statistics.moves += 1;
        self.record(ActRecord { event: "moved", position_um: Some(motion.to_um), ..ActRecord::default() });
        self.reply(motion.number, Reply::Vat(VatReply::Moved { position_um: motion.to_um }));
    }

    /// The device restarts: the position of a plate at rest is in non-volatile memory, that of a moving one is lost.
    pub(in crate::device::sim::core) fn lose_moving_position(&mut self) {
        self.vat.homed &= self.vat.motion.is_none();
    }

    /// The plate stops where it is. An interrupted homing has not found the zero position.
    pub(in crate::device::sim::core) fn stop_motion(&mut self) {
        let Some(motion) = self.vat.motion.take() else { return };
        self.vat.position_um = motion.position_um(self.now_us);
        let position_um = self.vat.homed.then_some(self.vat.position_um);
        self.record(ActRecord { event: "moved", position_um, reason: Some("stopped".into()), ..ActRecord::default() });
        self.reply(motion.number, Reply::Refused(Refusal::CutShort));
    }
}

impl Motion {
    pub(super) fn position_um(&self, now_us: u64) -> i32 {
        let whole_us = (self.arrives_us - self.began_us).max(1) as i128;
        let gone_us = now_us.clamp(self.began_us, self.arrives_us) - self.began_us;
        let way_um = i128::from(self.to_um) - i128::from(self.from_um);
        (i128::from(self.from_um) + way_um * i128::from(gone_us) / whole_us) as i32
    }
}
