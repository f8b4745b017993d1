//! The acts of a machine, the encodings of a layer, the driver, and simulated machines behind the same protocol.

mod act;
mod driver;
pub mod encoding;
mod light;
mod mismatch;
pub mod sim;
mod tolerance;

pub use act::{Act, Outcome};
pub use driver::{DriverBusy, DriverEvent, FramedDriver};
pub use light::{DARK_LIMIT_US, Light, LightWatch, STAYS_LIT};
pub use mismatch::{MachineMismatch, Misfit, check_capabilities, check_fit};
pub use tolerance::{Dose, least_exposure_us, least_move_us};
