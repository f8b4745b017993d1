//! The facts of a machine: what its lamp and its plate did, whatever the machine says of them.

use std::collections::VecDeque;

use layerd::layer::Bitmap;
use layerd::link::message::{ExposureId, Fault, Request, Urgent};
use layerd_wire::encoding::{LaserParameters, Vector};

/// One thing that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Fact {
    /// When, microseconds of the simulation's clock.
    pub at_us: u64,
    /// What.
    pub what: FactKind,
}

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum FactKind {
    /// The lamp goes on; `id` is `None` if no exposure was commanded.
    LightOn {
        /// The exposure.
        id: Option<ExposureId>,
        /// Its commanded time, 0 if none.
        commanded_ms: u32,
    },
    /// The lamp goes off.
    LightOff {
        /// What it went on for.
        id: Option<ExposureId>,
        /// How long it was on.
        lit_us: u64,
    },
    /// An exposure ran its whole time by the machine's clock; its light may last, see [`FactKind::LightOff`].
    ExposedWhole {
        /// Which.
        id: ExposureId,
        /// Light time by the machine's clock.
        duration_ms: u32,
        /// What was exposed.
        picture: Bitmap,
    },
    /// A laser was on a vector.
    Vector {
        /// Its layer.
        id: ExposureId,
        /// The vector.
        vector: Vector,
        /// What laser and scanner did.
        laser: LaserParameters,
        /// When the laser went on for it.
        began_us: u64,
        /// When it ended, or the laser went off within it.
        ended_us: u64,
        /// Whether it was marked to its end.
        is_whole: bool,
    },
    /// A layer was marked to its last vector.
    MarkedWhole {
        /// Which.
        id: ExposureId,
        /// How many vectors it has.
        vectors: u32,
    },
    /// Powder was spread.
    Recoated,
    /// An exposure ended early.
    CutShort {
        /// Which.
        id: ExposureId,
        /// Light time by the machine's clock.
        lit_ms: u32,
    },
    /// The plate begins to move. It moves evenly and does not turn back: its lowest point is at one of the ends.
    PlateLeaves {
        /// Where it is, above the bottom of the vat.
        um: i32,
        /// Where it goes, unless it is stopped.
        to_um: i32,
        /// Whether it looks for its zero position.
        homing: bool,
    },
    /// The plate comes to rest, at its target or where it was stopped.
    PlateAt {
        /// Where it is, above the bottom of the vat.
        um: i32,
        /// Whether it was looking for its zero position.
        homing: bool,
    },
    /// Somebody moved the plate by hand.
    PlatePushed {
        /// Where it was.
        from_um: i32,
        /// Where it is.
        to_um: i32,
    },
    /// A request other than for the state reached the machine.
    Asked(Request),
    /// A session begins.
    Hello {
        /// The session.
        session_id: u32,
    },
    /// The machine did not hear the host for 2 s.
    HostSilent,
    /// An urgent order was handled.
    Urgent {
        /// Its number.
        number: u32,
        /// The order.
        urgent: Urgent,
        /// Whether it was carried out.
        obeyed: bool,
        /// What was answered of the light; `None` for no answer.
        light_on: Option<bool>,
    },
    /// A fault begins or ends.
    Fault(Option<Fault>),
    /// The machine starts, after a power cut or a reset.
    Started {
        /// What tells this start from others.
        boot_id: u32,
    },
    /// The power is gone.
    PowerOff,
    /// The machine lied, or did something a right one does not do. For people.
    Lied(String),
}

/// The facts that were not taken yet, with the lamp and the plate that make them.
#[derive(Debug, Default)]
pub(super) struct Facts {
    untaken: VecDeque<Fact>,
    /// Since when the lamp is on, and what for.
    lamp: Option<(u64, Option<ExposureId>)>,
    /// The motion under way: whether it is a homing.
    motion: Option<bool>,
}

impl Facts {
    pub(super) fn note(&mut self, what: FactKind, at_us: u64) {
        self.untaken.push_back(Fact { at_us, what });
    }

    pub(super) fn take(&mut self) -> VecDeque<Fact> {
        std::mem::take(&mut self.untaken)
    }

    pub(super) fn is_lit(&self) -> bool {
        self.lamp.is_some()
    }

    /// The lamp goes on. If it was on already, it now is on for something else.
    pub(super) fn lamp_on(&mut self, id: Option<ExposureId>, commanded_ms: u32, at_us: u64) {
        self.lamp_off(at_us);
        self.lamp = Some((at_us, id));
        self.note(FactKind::LightOn { id, commanded_ms }, at_us);
    }

    /// The lamp goes off, if it is on.
    pub(super) fn lamp_off(&mut self, at_us: u64) {
        if let Some((since_us, id)) = self.lamp.take() {
            self.note(FactKind::LightOff { id, lit_us: at_us - since_us }, at_us);
        }
    }

    /// The plate came to rest.
    pub(super) fn plate_rests(&mut self, um: i32, at_us: u64) {
        let homing = self.motion.take().unwrap_or(false);
        self.note(FactKind::PlateAt { um, homing }, at_us);
    }

    /// The firmware moves the plate to `target`, if there is one, and whether it is a homing.
    pub(super) fn plate_moves(&mut self, um: i32, target: Option<(i32, bool)>, at_us: u64) {
        if let Some((to_um, homing)) = target
            && self.motion.is_none()
        {
            self.motion = Some(homing);
            self.note(FactKind::PlateLeaves { um, to_um, homing }, at_us);
        }
    }
}
