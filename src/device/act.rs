//! What a DLP machine is asked to do, and what came of it: the vocabulary between job engine and driver.

use crate::link::message::Refusal;

/// One thing to do; one at a time.
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
    /// Shine a layer that was uploaded.
    Expose {
        /// Which.
        layer: u32,
        /// Time with light, milliseconds.
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
        /// How long the light was on, milliseconds.
        duration_ms: u32,
    },
    /// The device did not do it.
    Refused(Refusal),
    /// An exposure that was taken back before it left the host.
    TakenBack,
}
