//! Drivers: each turns acts and layers into what one kind of device understands, and its answers into events. All of them do no
//! I/O and read no clock.
//!
//! [`FramedDriver`] drives machines that speak the framed protocol of `docs/protocol.md`. The daemon's loop uses it
//! (`daemon/machine/running.rs`).

mod framed;
mod upload;

pub use framed::{DriverBusy, DriverEvent, FramedDriver};
