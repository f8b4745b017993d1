//! Checks that the connected device is the configured machine and can print a recipe. `tests/device_driver.rs` shows each message.

use super::encoding::{self, Choice};
use crate::config::{DlpMachine, DlpRecipe, Kind, Machine, Recipe, SlmMachine, SlmRecipe};
use crate::layer::{Depth, MarkClass};
use crate::link::message::{Capabilities, MachineCapabilities, PowderCapabilities, VatCapabilities};
use crate::text::mm_text;

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
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
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
    /// The recipe's layers are lower or higher than the device can make them.
    #[error(
        "the recipe `{recipe}` has layers of {height_um} µm, but the device `{device}` makes layers of {} to {} µm: change \
         layer_height_um",
        .allowed_um[0], .allowed_um[1]
    )]
    LayerHeight {
        /// The recipe's name.
        recipe: String,
        /// The device's name.
        device: String,
        /// Layer height of the recipe, micrometres.
        height_um: f64,
        /// Least and greatest layer height of the device, micrometres.
        allowed_um: [u32; 2],
    },
    /// The recipe asks for more power than the device's laser has.
    #[error(
        "the recipe `{recipe}` marks with {} W, but the laser of the device `{device}` has at most {} W: lower laser_power_w",
        f64::from(*.power_mw) / 1000.0, f64::from(*.allowed_mw) / 1000.0
    )]
    Power {
        /// The recipe's name.
        recipe: String,
        /// The device's name.
        device: String,
        /// Greatest power of the recipe, milliwatts.
        power_mw: u32,
        /// Greatest power of the device, milliwatts.
        allowed_mw: u32,
    },
    /// The device reads no encoding of scan vectors.
    #[error("the device `{device}` reads no encoding of scan vectors that layerd writes. Update the device's firmware")]
    Vectors {
        /// The device's name.
        device: String,
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
    match (recipe, &capabilities.machine) {
        (Recipe::Dlp(recipe), MachineCapabilities::Vat(_)) => check_pictures(recipe, capabilities),
        (Recipe::Slm(recipe), MachineCapabilities::Powder(powder)) => check_vectors(recipe, powder, capabilities),
        _ => Err(other_kind(machine, capabilities, recipe.kind()).into()),
    }
}

fn check_pictures(recipe: &DlpRecipe, capabilities: &Capabilities) -> Result<Choice, Misfit> {
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

fn check_vectors(
    recipe: &SlmRecipe,
    powder: &PowderCapabilities,
    capabilities: &Capabilities,
) -> Result<Choice, Misfit> {
    let names = || (recipe.name.clone(), capabilities.name.clone());
    let [low_um, high_um] = powder.layer_height_um;
    let height_um = recipe.layer_height_um;
    if height_um < f64::from(low_um) || height_um > f64::from(high_um) {
        let (recipe, device) = names();
        return Err(Misfit::LayerHeight { recipe, device, height_um, allowed_um: [low_um, high_um] });
    }
    let strongest_mw = |class| (recipe.laser(class).power_w * 1000.0).round() as u32;
    let power_mw = MarkClass::ALL.into_iter().map(strongest_mw).max().unwrap_or(0);
    if power_mw > powder.max_power_mw {
        let ((recipe, device), allowed_mw) = (names(), powder.max_power_mw);
        return Err(Misfit::Power { recipe, device, power_mw, allowed_mw });
    }
    encoding::choose_vectors(&capabilities.encodings)
        .ok_or_else(|| Misfit::Vectors { device: capabilities.name.clone() })
}

/// Checks that a device is the configured machine.
///
/// # Errors
/// [`MachineMismatch`] names the first difference, configured and found.
pub fn check_capabilities(machine: &Machine, capabilities: &Capabilities) -> Result<(), MachineMismatch> {
    let difference = match (machine, &capabilities.machine) {
        (Machine::Dlp(machine), MachineCapabilities::Vat(vat)) => vat_difference(machine, vat),
        (Machine::Slm(machine), MachineCapabilities::Powder(powder)) => powder_difference(machine, powder),
        (Machine::Slm(_), MachineCapabilities::Vat(_)) | (Machine::Dlp(_), MachineCapabilities::Powder(_)) => {
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
        MachineCapabilities::Powder(_) => Kind::Slm,
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

/// A powder machine's field, power and travel.
fn powder_difference(machine: &SlmMachine, powder: &PowderCapabilities) -> Option<Difference> {
    let field = |[x, y]: [u32; 2]| format!("{} × {}", mm_text(x), mm_text(y));
    let wanted_um = machine.field_um.map(|um| um.round() as u32);
    if wanted_um != powder.field_um {
        return Some(Difference { what: "a field of", configured: field(wanted_um), found: field(powder.field_um) });
    }
    let power_w = f64::from(powder.max_power_mw) / 1000.0;
    if machine.max_power_w > power_w {
        let (configured, found) = (format!("{} W", machine.max_power_w), format!("{power_w} W"));
        return Some(Difference { what: "a laser of up to", configured, found });
    }
    let travel_um = f64::from(powder.max_position_um);
    (machine.build_height_um > travel_um).then(|| Difference {
        what: "a build height of",
        configured: mm_text(machine.build_height_um),
        found: mm_text(travel_um),
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
