//! Acts of a DLP machine and their outcomes: what job engine and driver exchange.

use crate::link::message::Refusal;

/// Something that the device does. Acts run one at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
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
    /// The device refused the act.
    Refused(Refusal),
    /// The exposure was taken back before it left the host.
    TakenBack,
}
