//! The host's end of the reliable session, a pure state machine: no I/O, no clock. The device's end and what both share are in
//! [`layerd_wire::session`].
//!
//! [`HostSession`] opens the session and sends urgent frames; the device answers. [`Hindrance`] says why data does not get
//! through. [`driver`](super::driver) runs a host session on a port. `tests/link_session.rs` joins both ends in virtual time.

mod hindrance;
mod host;

pub use hindrance::Hindrance;
pub use host::{HelloRefusal, HostEvent, HostSession, HostSettings, LostReason};
pub use layerd_wire::session::{SendError, Statistics};

/// A hello without an answer is repeated after this time: longer than a welcome takes at 9600 baud without a fault text.
pub const HELLO_REPEAT_US: u64 = 250_000;

/// An urgent frame without an answer is repeated after this time. Two tries and the answer fit into the 100 ms in which an urgent
/// frame must be answered.
pub const URGENT_REPEAT_US: u64 = 40_000;
