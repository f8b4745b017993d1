//! The line to the device: frames, a reliable session with credit, the serial transport. It does not know what a layer is.

pub mod message;
