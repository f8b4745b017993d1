//! The line to the device: frames, a reliable session with credit, the serial transport. It does not know what a layer is.
//!
//! | module        | owns                                                                                  |
//! |---------------|---------------------------------------------------------------------------------------|
//! | [`wire`]      | bytes: frames, messages, handshake; core and alloc only, firmware can share it         |
//!
//! `docs/protocol.md` is the contract between both ends.

pub mod wire;

pub use wire::message;
