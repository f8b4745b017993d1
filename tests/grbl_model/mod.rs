//! A model of a laser machine with a grbl 1.1 or grblHAL controller, at a pseudo-terminal, written from their documentation and from what
//! the real firmwares do. It keeps what really happened: marks, jumps, light, lines. `tests/grbl_conformance/` tests the model itself.
#![allow(dead_code, unused_imports, unreachable_pub, reason = "each test file uses its part")]

mod acts;
mod blocks;
pub mod facts;
mod gcode;
pub mod host;
mod lines;
mod machine;
mod motion;
pub mod options;
mod port;
mod system;
mod trouble;

pub use facts::{Facts, Jump, Mark};
pub(crate) use machine::Machine;
pub use options::{Fault, Firmware, Options};
pub use port::GrblModel;
