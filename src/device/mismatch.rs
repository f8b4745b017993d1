//! Checks that the connected device is the configured machine and can print a recipe. `tests/device_driver.rs` shows each message.

use super::encoding::{self, Choice};
use crate::config::{DlpMachine, Kind, Machine, Recipe};
use crate::layer::Depth;
use crate::link::message::{Capabilities, MachineCapabilities, VatCapabilities};

/// One layer is exposed while the next one arrives.
const MIN_SLOTS: u8 = 2;

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

/// A device that cannot print a recipe on a machine.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Misfit {
    /// It is another machine; no recipe changes that.
    #[error(transparent)]
    Machine(#[from] MachineMismatch),
    /// The recipe's exposure is longer than the device allows.
    #[error(
        "the recipe `{recipe}` exposes for {longest_ms} ms, but the device `{device}` allows at most {allowed_ms} ms: shorten \
         exposure_ms and bottom_exposure_ms"
    )]
    Exposure {
        /// The recipe's name.
        recipe: String,
        /// The device's name.
        device: String,
        /// Longest exposure of the recipe, milliseconds.
        longest_ms: u32,
        /// Longest exposure of the device, milliseconds.
        allowed_ms: u32,
    },
    /// The device reads no encoding of the recipe's depth.
    #[error(
        "the recipe `{recipe}` has {} layers, but the device `{device}` reads none of their encodings: {}",
        if *.antialias { "grey" } else { "black and white" }, encoding_remedy(!.antialias, *.reads_other)
    )]
    Encoding {
        /// The recipe's name.
        recipe: String,
        /// The device's name.
        device: String,
        /// Whether its layers are grey.
        antialias: bool,
        /// Whether the device reads an encoding of the other depth.
        reads_other: bool,
    },
}

/// What to do if a device reads no encoding of the recipe's layers; `other` is the other value of `antialias`.
fn encoding_remedy(other: bool, reads_other: bool) -> String {
    if reads_other {
        format!("set `antialias = {other}` in the recipe")
    } else {
        "it reads no encoding that layerd writes. Update the device's firmware".into()
    }
}

/// Checks that a device is the configured machine and can print the recipe. Returns how layers are encoded for it.
///
/// # Errors
/// [`Misfit`] names the first thing that does not fit, and what to do.
pub fn check_fit(machine: &Machine, recipe: &Recipe, capabilities: &Capabilities) -> Result<Choice, Misfit> {
    check_capabilities(machine, capabilities)?;
    let Recipe::Dlp(recipe) = recipe else {
        return Err(other_kind(machine, capabilities, recipe.kind()).into());
    };
    let names = || (recipe.name.clone(), capabilities.name.clone());
    let (longest_ms, allowed_ms) = (recipe.exposure_ms.max(recipe.bottom_exposure_ms), capabilities.max_exposure_ms);
    if longest_ms > allowed_ms {
        let (recipe, device) = names();
        return Err(Misfit::Exposure { recipe, device, longest_ms, allowed_ms });
    }
    let antialias = recipe.antialias;
    let other = if antialias { Depth::Bit } else { Depth::Grey };
    encoding::choose(recipe.depth(), &capabilities.encodings).ok_or_else(|| {
        let (recipe, device) = names();
        let reads_other = encoding::choose(other, &capabilities.encodings).is_some();
        Misfit::Encoding { recipe, device, antialias, reads_other }
    })
}

/// Checks that a device is the configured machine.
///
/// # Errors
/// [`MachineMismatch`] names the first difference, configured and found.
pub fn check_capabilities(machine: &Machine, capabilities: &Capabilities) -> Result<(), MachineMismatch> {
    let difference = match (machine, &capabilities.machine) {
        (Machine::Dlp(machine), MachineCapabilities::Vat(vat)) => vat_difference(machine, vat),
        (Machine::Slm(_), MachineCapabilities::Vat(_)) => {
            return Err(other_kind(machine, capabilities, machine.kind()));
        }
    };
    let Some(Difference { what, configured, found }) = difference.or_else(|| slots_difference(capabilities)) else {
        return Ok(());
    };
    let (machine, device) = (machine.name().to_owned(), capabilities.name.clone());
    Err(MachineMismatch { machine, device, what, configured, found })
}

/// The device is of another kind than the one that is configured.
fn other_kind(machine: &Machine, capabilities: &Capabilities, configured: Kind) -> MachineMismatch {
    let found = match &capabilities.machine {
        MachineCapabilities::Vat(_) => Kind::Dlp,
    };
    MachineMismatch {
        machine: machine.name().to_owned(),
        device: capabilities.name.clone(),
        what: "kind",
        configured: configured.to_string(),
        found: found.to_string(),
    }
}

/// What differs, as configured and as the device says.
struct Difference {
    what: &'static str,
    configured: String,
    found: String,
}

/// A vat machine's picture size and pixel pitch.
fn vat_difference(machine: &DlpMachine, vat: &VatCapabilities) -> Option<Difference> {
    let pixels = |[x, y]: [u32; 2]| format!("{x} × {y} pixels");
    let (wanted, found) = ([machine.width_px, machine.height_px], [vat.width_px, vat.height_px]);
    if wanted != found {
        return Some(Difference { what: "a picture of", configured: pixels(wanted), found: pixels(found) });
    }
    let pitch = |[x, y]: [u32; 2]| format!("{} × {} µm", f64::from(x) / 1000.0, f64::from(y) / 1000.0);
    let wanted = machine.pixel_um.map(|um| (um * 1000.0).round() as u32);
    (wanted != vat.pixel_nm).then(|| Difference {
        what: "a pixel pitch of",
        configured: pitch(wanted),
        found: pitch(vat.pixel_nm),
    })
}

/// The number of slots, which every kind of machine has.
fn slots_difference(capabilities: &Capabilities) -> Option<Difference> {
    (capabilities.layer_slots < MIN_SLOTS).then(|| Difference {
        what: "a device of",
        configured: format!("{MIN_SLOTS} layer slots or more"),
        found: capabilities.layer_slots.to_string(),
    })
}
