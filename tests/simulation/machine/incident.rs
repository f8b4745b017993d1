//! What happens to a machine from outside: power, cover, hands. Part of [`Machine`].

use layerd::device::sim::DeviceCore;
use layerd::link::message::Fault;
use layerd_wire::session::DeviceSession;

use super::Machine;
use super::character::{Character, Lie};
use super::facts::FactKind;

/// Fault code of an open cover.
const COVER_CODE: u16 = 2;

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
    /// Somebody opens the cover: the lamp goes off, the plate stops, and the machine has a fault.
    InterlockOpens,
    /// The cover is closed again.
    InterlockCloses,
    /// Somebody moves the plate, within its travel. It has an encoder. A plate that is being moved cannot be moved by hand.
    PlateMovedByHand {
        /// Where to, above the bottom of the vat.
        to_um: i32,
    },
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
            Incident::InterlockOpens => self.move_cover(true, now_us),
            Incident::InterlockCloses => self.move_cover(false, now_us),
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

    fn move_cover(&mut self, is_open: bool, now_us: u64) {
        if std::mem::replace(&mut self.is_cover_open, is_open) != is_open && self.is_on() {
            self.report_cover(now_us);
        }
    }

    /// An open cover cuts the lamp's power, whatever the firmware does.
    fn report_cover(&mut self, now_us: u64) {
        let fault = self.is_cover_open.then(|| Fault { code: COVER_CODE, text: "the cover is open".into() });
        self.facts.note(FactKind::Fault(fault.clone()), now_us);
        self.core.set_fault(fault, self.clock.machine_us(now_us));
        self.drain(now_us);
        if self.is_cover_open {
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
            self.core = DeviceCore::new(self.core.capabilities().clone(), self.boot_id);
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
        if self.is_cover_open {
            self.report_cover(now_us);
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
