//! The plate of any machine: position and moves. In a vat, a position is the height above the bottom; in a bed of powder, the depth
//! below the working plane. Part of [`Board`].

use super::board::Board;
use crate::device::sim::log::ActRecord;
use crate::link::message::{MachineCapabilities, PowderReply, Refusal, Reply, VatReply};

/// Speed of homing, micrometres a second.
const HOMING_SPEED_UM_S: u32 = 20_000;

/// Where the plate stands before the first homing. Only the simulation knows it.
const UNKNOWN_POSITION_UM: i32 = 20_000;

/// Position and move.
#[derive(Debug)]
pub(super) struct Plate {
    position_um: i32,
    homed: bool,
    motion: Option<Motion>,
}

/// A move under way.
#[derive(Debug)]
struct Motion {
    /// Number of the request, while its session lasts.
    number: Option<u32>,
    began_us: u64,
    arrives_us: u64,
    from_um: i32,
    to_um: i32,
    homing: bool,
}

impl Plate {
    /// At rest, and not homed.
    pub(super) fn new() -> Self {
        Self { position_um: UNKNOWN_POSITION_UM, homed: false, motion: None }
    }

    /// When a move under way ends.
    pub(super) fn next_timeout_us(&self) -> Option<u64> {
        self.motion.as_ref().map(|motion| motion.arrives_us)
    }

    pub(super) fn is_moving(&self) -> bool {
        self.motion.is_some()
    }

    pub(super) fn is_homed(&self) -> bool {
        self.homed
    }

    /// Where the plate is; `None` before homing.
    pub(super) fn position_um(&self, now_us: u64) -> Option<i32> {
        self.homed.then_some(self.true_position_um(now_us))
    }

    /// Where the plate is, homed or not.
    pub(super) fn true_position_um(&self, now_us: u64) -> i32 {
        self.motion.as_ref().map_or(self.position_um, |motion| motion.position_um(now_us))
    }

    /// Where the motion under way ends, and whether it is a homing.
    pub(super) fn target(&self) -> Option<(i32, bool)> {
        self.motion.as_ref().map(|motion| (motion.to_um, motion.homing))
    }

    /// Somebody moves the plate by hand. Does nothing and returns `false` while a motion holds the plate.
    pub(super) fn push(&mut self, to_um: i32) -> bool {
        let is_free = self.motion.is_none();
        if is_free {
            self.position_um = to_um;
        }
        is_free
    }

    /// The session has ended: a move under way goes on without a reply.
    pub(super) fn forget_request(&mut self) {
        if let Some(motion) = &mut self.motion {
            motion.number = None;
        }
    }

    /// The device restarts: the position of a plate at rest is in non-volatile memory, that of a moving one is lost.
    pub(super) fn lose_moving_position(&mut self) {
        self.homed &= self.motion.is_none();
    }
}

impl Motion {
    fn position_um(&self, now_us: u64) -> i32 {
        let whole_us = (self.arrives_us - self.began_us).max(1) as i128;
        let gone_us = now_us.clamp(self.began_us, self.arrives_us) - self.began_us;
        let way_um = i128::from(self.to_um) - i128::from(self.from_um);
        (i128::from(self.from_um) + way_um * i128::from(gone_us) / whole_us) as i32
    }
}

impl Board {
    /// Ends a move that is due by `now_us`, at its own time.
    pub(super) fn advance_plate(&mut self, now_us: u64) {
        if let Some(motion) = self.plate.motion.take_if(|motion| motion.arrives_us <= now_us) {
            self.now_us = motion.arrives_us;
            self.arrive(&motion);
        }
    }

    /// Begins to search for the zero position.
    pub(super) fn begin_homing(&mut self, number: u32) {
        self.begin_motion(number, 0, HOMING_SPEED_UM_S, true);
    }

    /// Begins a move.
    pub(super) fn begin_move(&mut self, number: u32, position_um: i32, speed_um_s: u32) -> Result<(), Refusal> {
        if !self.plate.homed {
            return Err(Refusal::NotHomed);
        }
        if speed_um_s == 0 || !(0..=self.capabilities.machine.max_position_um()).contains(&position_um) {
            return Err(Refusal::BadMove);
        }
        self.begin_motion(number, position_um, speed_um_s, false);
        Ok(())
    }

    fn begin_motion(&mut self, number: u32, to_um: i32, speed_um_s: u32, homing: bool) {
        let way_um = u64::from(self.plate.position_um.abs_diff(to_um));
        let arrives_us = self.now_us + way_um * 1_000_000 / u64::from(speed_um_s);
        let (began_us, from_um) = (self.now_us, self.plate.position_um);
        self.plate.motion = Some(Motion { number: Some(number), began_us, arrives_us, from_um, to_um, homing });
        // A move to the present position ends at once.
        self.advance_plate(self.now_us);
    }

    fn arrive(&mut self, motion: &Motion) {
        let position_um = motion.to_um;
        self.plate.position_um = position_um;
        self.plate.homed |= motion.homing;
        self.statistics.moves += 1;
        self.record(ActRecord { event: "moved", position_um: Some(position_um), ..ActRecord::default() });
        let reply = match self.capabilities.machine {
            MachineCapabilities::Vat(_) => Reply::Vat(VatReply::Moved { position_um }),
            MachineCapabilities::Powder(_) => Reply::Powder(PowderReply::Moved { position_um }),
        };
        self.reply(motion.number, reply);
    }

    /// The plate stops where it is. An interrupted homing has not found the zero position.
    pub(super) fn stop_motion(&mut self) {
        let Some(motion) = self.plate.motion.take() else { return };
        self.plate.position_um = motion.position_um(self.now_us);
        let position_um = self.plate.homed.then_some(self.plate.position_um);
        self.record(ActRecord { event: "moved", position_um, reason: Some("stopped".into()), ..ActRecord::default() });
        self.reply(motion.number, Reply::Refused(Refusal::CutShort));
    }
}
