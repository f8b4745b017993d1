//! Machines: what they are told to do, how layers are encoded for them, their drivers, and simulated ones.
//!
//! | module       | owns                                                                                     |
//! |--------------|------------------------------------------------------------------------------------------|
//! | `act`        | acts and their outcomes                                                                  |
//! | `driver`     | acts and layers as messages, replies as events                                           |
//! | [`encoding`] | which encoding a device gets                                                             |
//! | `light`      | whether a device shines only as commanded                                                |
//! | `mismatch`   | whether a device is the configured machine, and can print a recipe                       |
//! | `passes`     | the exposures of a part's layers, in order                                               |
//! | `tolerance`  | how far reports may differ from commands                                                 |
//! | `scan_time`  | how long a laser takes for a layer                                                       |
//! | `axes_time`  | the same where axes move the beam                                                        |
//! | [`sim`]      | simulated machines behind the same protocol                                              |
//!
//! `tests/device_common/print.rs` is the smallest host that prints with it.

mod act;
mod axes_time;
mod driver;
pub mod encoding;
mod light;
mod mismatch;
mod passes;
mod scan_time;
pub mod sim;
mod tolerance;

pub use act::{Act, Outcome, PowderAct, PowderOutcome, VatAct, VatOutcome};
pub use axes_time::{AxesMotion, BYTES_PER_MARK};
pub use driver::{DriverBusy, DriverEvent, FramedDriver};
pub use light::{DARK_LIMIT_US, Light, LightWatch, STAYS_LIT};
pub use mismatch::{MachineMismatch, Misfit, check_capabilities, check_fit};
pub use passes::{Pass, Passes};
pub use scan_time::{ScanClock, ScanTimes};
pub use tolerance::{Dose, host_us, least_exposure_us, least_move_us};
