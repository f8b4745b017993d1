//! Acts of a machine and their outcomes: what job engine and driver exchange. See them used in `job/cycle/`, which decides what a
//! machine does, and in the driver, which makes requests of it.

use crate::link::message::Refusal;

/// Something that a machine does, by kind of machine. Acts run one at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// An act of a machine with a vat.
    Vat(VatAct),
    /// An act of a machine with a bed of powder.
    Powder(PowderAct),
}

impl Act {
    /// Whether the act lets light out. Such an act must not begin after an order to go dark.
    pub const fn is_exposure(&self) -> bool {
        // Without `_`, so that a new kind of machine or act must be decided on here.
        match self {
            Self::Vat(VatAct::Home | VatAct::Move { .. } | VatAct::Change { .. })
            | Self::Powder(PowderAct::Home | PowderAct::Move { .. } | PowderAct::Recoat) => false,
            Self::Vat(VatAct::Expose { .. }) | Self::Powder(PowderAct::Mark { .. }) => true,
        }
    }
}

/// What a machine with a vat, a plate and a projector does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VatAct {
    /// Find the zero position, plate at the bottom of the vat.
    Home,
    /// Move the plate.
    Move {
        /// Height above the bottom of the vat, micrometres.
        position_um: i32,
        /// Micrometres a second.
        speed_um_s: u32,
    },
    /// Expose a layer that was uploaded.
    Expose {
        /// Which.
        layer: u32,
        /// Number of the exposure within the layer.
        pass: u8,
        /// Commanded light time, milliseconds.
        duration_ms: u32,
        /// Light power, 1 to 255.
        light_pwm: u8,
    },
    /// Put another vat in place, and wash what hangs on the plate in between.
    Change {
        /// The vat, from 1 on.
        vat: u8,
        /// How long to wash, milliseconds.
        wash_ms: u32,
        /// How long to let it drain after that, milliseconds.
        drain_ms: u32,
    },
}

/// What a machine with a bed of powder, a recoater and a laser does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowderAct {
    /// Find the zero position: plate level with the working plane, recoater at rest.
    Home,
    /// Move the plate.
    Move {
        /// Depth below the working plane, micrometres.
        position_um: i32,
        /// Micrometres a second.
        speed_um_s: u32,
    },
    /// Spread powder over the plate.
    Recoat,
    /// Mark a layer that was uploaded.
    Mark {
        /// Which.
        layer: u32,
        /// The first vector to mark.
        from_vector: u32,
        /// Longest time of the act, milliseconds; after that the laser stops at the end of a vector.
        most_ms: u32,
    },
}

/// How an [`Act`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// An act of a machine with a vat was done.
    Vat(VatOutcome),
    /// An act of a machine with a bed of powder was done.
    Powder(PowderOutcome),
    /// The device refused the act.
    Refused(Refusal),
    /// The exposure was taken back before it left the host.
    TakenBack,
}

/// What a machine with a vat has done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VatOutcome {
    /// Homed or moved: the plate is there.
    Arrived {
        /// Height above the bottom of the vat, micrometres.
        position_um: i32,
    },
    /// The exposure ran its whole time.
    Exposed {
        /// Which layer.
        layer: u32,
        /// Which exposure of it.
        pass: u8,
        /// Light time that the device reported, milliseconds.
        duration_ms: u32,
    },
    /// The vat is in place.
    Changed {
        /// Which, from 1 on.
        vat: u8,
    },
}

/// What a machine with a bed of powder has done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowderOutcome {
    /// Homed or moved: the plate is there.
    Arrived {
        /// Depth below the working plane, micrometres.
        position_um: i32,
    },
    /// Powder is spread, and the recoater is at rest.
    Recoated,
    /// The layer is marked to its last vector.
    Marked {
        /// Which layer.
        layer: u32,
        /// Number of its vectors, as the device counts them.
        vectors: u32,
        /// How long the laser was on in this act, as the device reported it, milliseconds.
        laser_ms: u32,
        /// How long the laser waited, off, for layer data, milliseconds.
        starved_ms: u32,
    },
}
