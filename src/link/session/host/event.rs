//! What a host session reports to its owner, and why a session ends. `tests/link_causes.rs` shows most.

use crate::link::grbl::GrblMisfit;
use layerd_wire::message::{Capabilities, DeviceMessage, DeviceState};
use layerd_wire::{MIN_FRAME_BYTES, MIN_HOST_FRAME_BYTES, VersionRange, WireError};

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HostEvent {
    /// The device accepted the session.
    Connected {
        /// The session.
        session_id: u32,
        /// What the device is.
        capabilities: Capabilities,
        /// Its state when it answered. As in every state that the host reports, `slots` has an entry for each slot.
        state: DeviceState,
        /// The longest piece of layer data that fits into a frame.
        largest_layer_data_bytes: usize,
    },
    /// A message; each comes once and in order.
    Message(DeviceMessage),
    /// The device carried out an urgent frame.
    UrgentDone {
        /// Its number.
        number: u32,
        /// Whether the light is on now.
        light_on: bool,
    },
    /// The session has ended. Only messages may follow.
    Lost(LostReason),
    /// The device does not accept this host, or cannot be used. The session has ended.
    Refused(HelloRefusal),
}

/// Why a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LostReason {
    /// No answer to the hello within 2 s.
    #[error("{}", no_answer(*.garbage_frames))]
    NoAnswer {
        /// Number of damaged frames.
        garbage_frames: u64,
    },
    /// Nothing was heard for 2 s.
    #[error("the device has been silent for 2 s")]
    Silent,
    /// The device does not know the session: it was reset, or did not hear the host for 2 s.
    #[error("the device no longer knows the session; it was reset or had lost the line")]
    DeviceForgot,
    /// An intact message makes no sense.
    #[error("the device sent a message that makes no sense: {0}")]
    BadMessage(WireError),
    /// An acknowledgement of data that was never sent.
    #[error(
        "the device acknowledged data frames up to {acknowledged}, but only those below {sent} were sent: its firmware does \
         not follow the protocol"
    )]
    FalseAck {
        /// The number that the device expects next.
        acknowledged: u32,
        /// The first number that was not sent.
        sent: u32,
    },
}

/// Leaves the count out, which differs each time: the same cause gives the same text and is reported once.
fn no_answer(garbage_frames: u64) -> &'static str {
    if garbage_frames == 0 {
        "the device does not answer; is it switched on, and is this its port?"
    } else {
        "the device does not answer, and what comes is garbage; is `baud` its line rate, and is this its port?"
    }
}

/// Which side to update when host and device speak no common version.
fn version_remedy(host: VersionRange, device: VersionRange) -> &'static str {
    if host.highest_common(device).is_some() {
        "it refuses a version that both speak: its firmware does not follow the protocol"
    } else if device.highest < host.lowest {
        "update the device's firmware"
    } else {
        "update layerd"
    }
}

/// Why host and device do not fit.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HelloRefusal {
    /// Host and device speak no common version.
    #[error("the device speaks {device} of the protocol, this host speaks {host}: {}", version_remedy(*.host, *.device))]
    Version {
        /// The versions that the host speaks.
        host: VersionRange,
        /// The versions that the device speaks.
        device: VersionRange,
    },
    /// The device refuses the host's versions, and states a range of its own that holds no version.
    #[error(
        "the device refuses this host's version of the protocol, and states for itself the versions from {} to {}, which is no \
         range of versions: its firmware does not follow the protocol", .device.lowest, .device.highest
    )]
    NoVersion {
        /// The range that the device states.
        device: VersionRange,
    },
    /// The device chose a version that the host did not offer.
    #[error(
        "the device chose version {chosen} of the protocol, but this host offered {host}: its firmware does not follow the \
         protocol"
    )]
    NotOffered {
        /// The versions that the host offered.
        host: VersionRange,
        /// The version that the device chose.
        chosen: u16,
    },
    /// The device is a machine of a kind that this host does not know.
    #[error(
        "the device is a machine of kind {kind}, which this host does not know: connect the right device, or update layerd"
    )]
    UnknownMachine {
        /// The kind's code.
        kind: u8,
    },
    /// The device requires larger limits than this host's, which are those of the protocol or above.
    #[error(
        "the device finds this host's window of {window_bytes} bytes or its frames of {largest_frame_bytes} bytes too small, although \
         the protocol asks for only {MIN_HOST_FRAME_BYTES} of each: update the device's firmware"
    )]
    Limits {
        /// The host's window.
        window_bytes: u32,
        /// The host's largest frame.
        largest_frame_bytes: u16,
    },
    /// The device refuses, and the reason makes no sense.
    #[error("the device refuses this host, and its reason makes no sense: {0}; check its firmware")]
    BadRefusal(WireError),
    /// It is a grbl controller that cannot be used.
    #[error(transparent)]
    Grbl(#[from] GrblMisfit),
    /// The welcome makes no sense.
    #[error("the device's welcome makes no sense: {0}")]
    BadWelcome(WireError),
    /// The device's limits are below those of the protocol.
    #[error(
        "the device states a window of {window_bytes} bytes and frames of {largest_frame_bytes}; both must be at least {MIN_FRAME_BYTES}"
    )]
    BadLimits {
        /// Stated window.
        window_bytes: u32,
        /// Stated largest frame.
        largest_frame_bytes: u16,
    },
}
