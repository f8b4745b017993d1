//! Acts of a machine and their outcomes: what job engine and driver exchange. See them used in `job/cycle/vat.rs`, which decides
//! what a machine with a vat does, and in the driver, which makes requests of it.

use crate::link::message::Refusal;

/// Something that a machine does, by kind of machine. Acts run one at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// An act of a machine with a vat.
    Vat(VatAct),
}

impl Act {
    /// Whether the act lets light out. Such an act must not begin after an order to go dark.
    pub const fn is_exposure(&self) -> bool {
        // Without `_`, so that a new kind of machine or act must be decided on here.
        match self {
            Self::Vat(VatAct::Home | VatAct::Move { .. }) => false,
            Self::Vat(VatAct::Expose { .. }) => true,
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
        /// Commanded light time, milliseconds.
        duration_ms: u32,
        /// Light power, 1 to 255.
        light_pwm: u8,
    },
}

/// How an [`Act`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// An act of a machine with a vat was done.
    Vat(VatOutcome),
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
        /// Light time that the device reported, milliseconds.
        duration_ms: u32,
    },
}
