//! What a machine is asked to do, how a layer is written for it, and simulated machines behind the same protocol.

mod act;

pub use act::{Act, Outcome};
