//! The line to the device: the host's session with it, and the serial port.
//!
//! | module        | owns                                                                                  |
//! |---------------|---------------------------------------------------------------------------------------|
//! | [`message`]   | what host and device say to each other; part of [`layerd_wire`], as all bytes are      |
//! | [`session`]   | the host's session: urgent frames, versions, what hinders data: a pure state machine   |
//! | [`grbl`]      | the same for a grbl controller, which speaks lines of G-code                           |
//! | [`transport`] | the serial port, real or pseudo-terminal                                               |
//! | [`driver`]    | the task that joins a session to its port: pacing, timers, reconnecting                 |
//!
//! The crate [`layerd_wire`] has what firmware shares: frames, messages, handshake, the machinery of a session. `docs/protocol.md` is
//! the contract between both ends. `tests/link_port.rs` shows a line from [`driver::link`] to a device.

mod conversation;
pub mod driver;
pub mod grbl;
mod pacing;
pub mod session;
mod settings;
mod spacing;
pub mod transport;

pub use layerd_wire::message;
pub use settings::{FlowControl, LinkSettings, Protocol};
pub use transport::{Ports, SystemPorts};
