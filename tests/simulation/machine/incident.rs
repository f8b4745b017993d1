//! What happens to a machine from outside: power, cover, hands. Part of [`Machine`].

use layerd::device::sim::DeviceCore;
use layerd::link::message::Fault;
use layerd_wire::session::DeviceSession;

use super::Machine;
use super::character::{Character, Lie};
use super::facts::FactKind;

/// What happens to a machine from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Incident {
    /// It restarts; its non-volatile memory survives.
    Reset,
    /// The power is gone for so long: dark, the plate stays, nothing is heard. It starts with a new boot id.
    PowerCut {
        /// For how long.
        off_us: u64,
    },
    /// The lamp goes off, the plate stops, and the machine has a fault.
    InterlockOpens(Interlock),
    /// It is as it should be again.
    InterlockCloses(Interlock),
    /// Somebody moves the plate, within its travel. It has an encoder. A plate that is being moved cannot be moved by hand.
    PlateMovedByHand {
        /// Where to, above the bottom of the vat.
        to_um: i32,
    },
}

/// What keeps a machine dark and still.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Interlock {
    /// Somebody opens the cover.
    Cover,
    /// The gas around the powder has too much oxygen.
    Oxygen,
    /// The laser has no power.
    LaserPower,
}

impl Interlock {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Cover, Self::Oxygen, Self::LaserPower];

    fn fault(self) -> Fault {
        let (code, text) = match self {
            Self::Cover => (2, "the cover is open"),
            Self::Oxygen => (10, "oxygen at 1.2 %: above 0.5 %"),
            Self::LaserPower => (12, "the laser has no power"),
        };
        Fault { code, text: text.into() }
    }
}

impl Machine {
    /// Something happens to it from outside.
    pub fn strike(&mut self, incident: Incident, now_us: u64) {
        self.catch_up(now_us);
        match incident {
            Incident::Reset => {
                if self.is_on() {
                    self.shut_down(now_us);
                    self.start(now_us);
                }
            }
            Incident::PowerCut { off_us } => {
                if self.is_on() {
                    self.facts.note(FactKind::PowerOff, now_us);
                    self.shut_down(now_us);
                }
                self.off_until_us = self.off_until_us.max(Some(now_us + off_us));
            }
            Incident::InterlockOpens(interlock) => self.change_interlock(interlock, true, now_us),
            Incident::InterlockCloses(interlock) => self.change_interlock(interlock, false, now_us),
            Incident::PlateMovedByHand { to_um } => {
                let (from_um, to_um) = (self.plate_um(), to_um.clamp(0, self.max_position_um()));
                if self.core.push_plate(to_um, self.clock.machine_us(now_us)) {
                    self.facts.note(FactKind::PlatePushed { from_um, to_um }, now_us);
                }
            }
        }
        if self.is_on() {
            self.pump(now_us);
        }
    }

    fn change_interlock(&mut self, interlock: Interlock, opens: bool, now_us: u64) {
        let has_changed = if opens { self.open.insert(interlock) } else { self.open.remove(&interlock) };
        if has_changed && self.is_on() {
            self.report_interlocks(now_us);
        }
    }

    /// An open interlock cuts the lamp's power, whatever the firmware does.
    fn report_interlocks(&mut self, now_us: u64) {
        let fault = self.open.first().map(|interlock| interlock.fault());
        self.facts.note(FactKind::Fault(fault.clone()), now_us);
        self.core.set_fault(fault, self.clock.machine_us(now_us));
        self.drain(now_us);
        if !self.open.is_empty() {
            self.stray = None;
            self.facts.lamp_off(now_us);
        }
    }

    /// The power goes: dark, the plate stops, everything but the non-volatile memory is lost.
    fn shut_down(&mut self, now_us: u64) {
        self.boot_id = self.rng.next_u64() as u32;
        self.core.reset(self.boot_id, self.clock.machine_us(now_us));
        self.drain(now_us);
        let lie = self.liar.due(|lie| lie == Lie::LosesMemory);
        self.note_lie(lie, now_us);
        if lie.is_some() {
            let plate_um = self.plate_um();
            self.core = DeviceCore::new(self.core.capabilities().clone(), self.boot_id).telling_vectors();
            // The plate stays where it is.
            self.core.push_plate(plate_um, self.clock.machine_us(now_us));
        }
        self.forget_messages();
        self.stray = None;
        self.facts.lamp_off(now_us);
        self.clock.correct(now_us);
        (self.picture, self.flood, self.position_offset_um) = (None, None, 0);
    }

    pub(super) fn start(&mut self, now_us: u64) {
        self.off_until_us = None;
        self.session = DeviceSession::new(self.core.capabilities().clone(), self.settings, now_us);
        self.facts.note(FactKind::Started { boot_id: self.boot_id }, now_us);
        if !self.open.is_empty() {
            self.report_interlocks(now_us);
        }
    }

    /// It restarts by itself.
    pub(super) fn reboot(&mut self, now_us: u64) {
        let Character::Liar { lie: lie @ Lie::Reboots { every_us }, count, .. } = self.character() else { return };
        self.liar.told += 1;
        self.note_lie(Some(lie), now_us);
        self.reboot_at_us = (self.liar.told < count).then_some(now_us + every_us.max(1));
        self.shut_down(now_us);
        self.start(now_us);
    }
}
