//! What a machine is asked to do, how a layer is written for it, and simulated machines behind the same protocol.

mod act;
mod dlp;
pub mod encoding;
mod mismatch;
pub mod sim;

pub use act::{Act, Outcome};
pub use dlp::{DlpDriver, DriverBusy, DriverEvent};
pub use mismatch::{MachineMismatch, Misfit, check_capabilities, check_fit};
