//! Whether the device at the line is the machine that is configured.

use crate::config::Machine;
use crate::link::message::{Capabilities, DeviceKind};

/// One layer is exposed while the next arrives.
const LEAST_SLOTS: u8 = 2;

/// The device is not the machine that is configured.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "machine `{machine}` is configured with {what} {configured}, but the device `{device}` says {found}: correct the machine \
     file, or connect the right device"
)]
pub struct MachineMismatch {
    /// The machine's name.
    pub machine: String,
    /// The device's name.
    pub device: String,
    /// What differs.
    pub what: &'static str,
    /// As configured.
    pub configured: String,
    /// As the device says.
    pub found: String,
}

/// Checks that a device is the configured machine: kind, picture size and pixel pitch; and that it has the slots of one.
///
/// # Errors
/// [`MachineMismatch`] names the first difference, configured and found.
pub fn check_capabilities(machine: &Machine, capabilities: &Capabilities) -> Result<(), MachineMismatch> {
    let differs = |what, configured: String, found: String| {
        let (machine, device) = (machine.name.clone(), capabilities.name.clone());
        Err(MachineMismatch { machine, device, what, configured, found })
    };
    if capabilities.kind != DeviceKind::Dlp {
        return differs("kind", "dlp".into(), "slm".into());
    }
    let pixels = |[x, y]: [u32; 2]| format!("{x} × {y} pixels");
    let (wanted, found) = ([machine.width_px, machine.height_px], [capabilities.width_px, capabilities.height_px]);
    if wanted != found {
        return differs("a picture of", pixels(wanted), pixels(found));
    }
    let pitch = |[x, y]: [u32; 2]| format!("{} × {} µm", f64::from(x) / 1000.0, f64::from(y) / 1000.0);
    let wanted = machine.pixel_um.map(|um| (um * 1000.0).round() as u32);
    if wanted != capabilities.pixel_nm {
        return differs("a pixel pitch of", pitch(wanted), pitch(capabilities.pixel_nm));
    }
    if capabilities.layer_slots < LEAST_SLOTS {
        return differs(
            "a device of",
            format!("{LEAST_SLOTS} layer slots or more"),
            capabilities.layer_slots.to_string(),
        );
    }
    Ok(())
}
