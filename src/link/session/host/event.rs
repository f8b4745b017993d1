//! What a host session reports to its owner, and why a session ends.

use crate::link::message::{Capabilities, DeviceMessage, DeviceState};
use crate::link::wire::{MIN_FRAME_BYTES, PROTOCOL_VERSION, WireError};

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HostEvent {
    /// The device accepted the session.
    Connected {
        /// Of this session.
        session_id: u32,
        /// What it is.
        capabilities: Capabilities,
        /// What it was doing when it answered. As in every state from here, `slots` has an entry for each slot.
        state: DeviceState,
        /// The longest piece of layer data that fits a frame.
        largest_layer_data_bytes: usize,
    },
    /// A message, in order, once.
    Message(DeviceMessage),
    /// The device carried out an urgent frame.
    UrgentDone {
        /// Its number.
        number: u32,
        /// Whether there is light now.
        light_on: bool,
    },
    /// The session has ended; the last event but for messages.
    Lost(LostReason),
    /// The device does not accept this host, or cannot be used; the session has ended.
    Refused(HelloRefusal),
}

/// Why a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LostReason {
    /// No answer to the hello within 2 s.
    #[error("{}", no_answer(*.garbage_frames))]
    NoAnswer {
        /// Frames that were damaged or no frames at all.
        garbage_frames: u64,
    },
    /// Nothing heard for 2 s.
    #[error("the device has been silent for 2 s")]
    Silent,
    /// The device does not know the session: it was reset, or had not heard the host for 2 s.
    #[error("the device no longer knows the session; it was reset or had lost the line")]
    DeviceForgot,
    /// A message came whole but makes no sense.
    #[error("the device sent a message that makes no sense: {0}")]
    BadMessage(WireError),
    /// An acknowledgement of data that was never sent.
    #[error(
        "the device acknowledged data frames up to {acknowledged}, but only those below {sent} were sent: its firmware does \
         not follow the protocol"
    )]
    FalseAck {
        /// The number that the device expects next, by its own word.
        acknowledged: u32,
        /// The first number that was not sent.
        sent: u32,
    },
}

/// Without the count, which is another each time: one cause is told once.
fn no_answer(garbage_frames: u64) -> &'static str {
    if garbage_frames == 0 {
        "the device does not answer; is it switched on, and is this its port?"
    } else {
        "the device does not answer, and what comes is garbage; is `baud` its line rate, and is this its port?"
    }
}

fn versions(lowest: u16, highest: u16) -> String {
    if lowest == highest { format!("version {lowest}") } else { format!("versions {lowest} to {highest}") }
}

/// Why host and device do not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HelloRefusal {
    /// No common version.
    #[error("the device speaks {} of the protocol, this host speaks {PROTOCOL_VERSION}", versions(*.lowest, *.highest))]
    Version {
        /// Lowest version the device speaks.
        lowest: u16,
        /// Highest version the device speaks.
        highest: u16,
    },
    /// The device asks for larger limits than this host's.
    #[error("the device finds the host's window or frames too small")]
    Limits,
    /// The welcome makes no sense.
    #[error("the device's welcome makes no sense: {0}")]
    BadWelcome(WireError),
    /// The device's own limits are below what the protocol asks for.
    #[error(
        "the device states a window of {window_bytes} bytes and frames of {largest_frame_bytes}; both must be at least {MIN_FRAME_BYTES}"
    )]
    BadLimits {
        /// Window it stated.
        window_bytes: u32,
        /// Largest frame it stated.
        largest_frame_bytes: u16,
    },
}
