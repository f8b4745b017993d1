//! The line to the device: frames and messages, a reliable session with credit, the serial port.
//!
//! | module        | owns                                                                                  |
//! |---------------|---------------------------------------------------------------------------------------|
//! | [`wire`]      | bytes: frames, messages, handshake; core and alloc only, so firmware can share it      |
//! | [`session`]   | order, loss, credit, urgency, silence: a pure state machine for host and device        |
//! | [`transport`] | the serial port, real or pseudo-terminal                                               |
//! | [`driver`]    | the task that joins a host session to its port: pacing, timers, reconnecting            |
//!
//! `docs/protocol.md` is the contract between both ends.

pub mod driver;
mod pacing;
pub mod session;
mod settings;
mod spacing;
pub mod transport;
pub mod wire;

pub use settings::{FlowControl, LinkSettings};
pub use wire::message;
