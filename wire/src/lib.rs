#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod bytes;
mod codec;
pub mod encoding;
mod escape;
mod frame;
mod handshake;
pub mod message;
pub mod powder;
pub mod session;
mod version;

pub use bytes::WireError;
pub use codec::{MAX_SLOTS, decode_device_message, decode_host_message, encode_device_message, encode_host_message};
pub use escape::{Unescaper, escape};
pub use frame::{Decoded, Frame, FrameDecoder, FrameError, FrameKind, encode_frame, payload_limit};
pub use handshake::{Ack, Hello, HelloRefused, UrgentDone, Welcome, decode_urgent, encode_urgent};
pub use version::{VERSIONS, VersionRange};

/// Smallest "largest frame" that a device may state: the frame of the longest request (29 bytes), and some room.
pub const MIN_FRAME_BYTES: u16 = 64;

/// Smallest "largest frame" that a host may state. The frame of a welcome with every list and text at its limit has at most 539
/// bytes; the rest is for kinds of machines to come.
pub const MIN_HOST_FRAME_BYTES: u16 = 640;
