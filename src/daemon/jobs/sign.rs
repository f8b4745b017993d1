//! Signs of an earlier part on the plate or in the vat. `tests/plate.rs` shows each.

use std::fmt;

use crate::job::Trace;
use crate::link::message::{DeviceState, ExposureId};
use crate::text::mm_text;

/// A plate this far below the clear height still counts as clear, micrometres: axes report positions to some ten micrometres.
pub(crate) const CLEAR_TOLERANCE_UM: i32 = 100;

/// How deep a plate may be that counts as level with the working plane, micrometres: a few steps of an axis. A single layer is deeper.
pub(crate) const LEVEL_TOLERANCE_UM: i32 = 5;

/// Signs kept for a job. A device shows a handful, and few devices are connected one after the other.
pub(crate) const MAX_SIGNS: usize = 64;

/// Where the device's state shows an exposure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Seen {
    LastExposed,
    CutShort,
    Exposing,
    InSlot,
}

/// A sign of an earlier part that may be on the plate or in the vat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sign {
    /// The device shows an exposure that no journal here accounts for.
    Exposure {
        /// The exposure.
        trace: Trace,
        /// Where the device's state shows it.
        seen: Seen,
        /// The job with its key, whose journal has no record of it; `None` if no job here has that key.
        job: Option<u32>,
    },
    /// The plate is not clear of the resin.
    Low {
        /// Where it is.
        position_um: i32,
        /// Where it would be clear.
        clear_um: i32,
        /// Boot id of the device.
        boot_id: u32,
    },
    /// The plate is below the working plane of a bed of powder.
    Deep {
        /// By how much.
        position_um: i32,
        /// Boot id of the device.
        boot_id: u32,
    },
    /// `layerctl raise` lifted a plate that was not clear of the resin.
    Raised {
        /// From where.
        from_um: i32,
    },
    /// The job's plate was found empty on another device, or before this one was restarted; and this device has printed another job.
    OtherDevice {
        /// Boot id of the device.
        boot_id: u32,
    },
    /// A job of this spool ended, and no record says that its plate was lifted.
    Left {
        /// The job.
        job: u32,
        /// Names its exposures.
        key: u64,
    },
}

impl Sign {
    /// Whether an operator who has confirmed the signs `known` has thereby confirmed this one. `state` is the device's.
    pub(crate) fn is_known(&self, known: &[Self], state: Option<&DeviceState>) -> bool {
        known.iter().any(|known| match (self, known) {
            (Self::Exposure { trace, .. }, Self::Exposure { trace: known, .. }) => trace == known,
            (Self::Low { boot_id, .. }, Self::Low { boot_id: known, .. })
            | (Self::Deep { boot_id, .. }, Self::Deep { boot_id: known, .. }) => boot_id == known,
            // A part left in the vat means a low plate, on the device that printed it.
            (Self::Low { .. } | Self::Deep { .. }, Self::Left { key, .. }) => state.is_some_and(|state| {
                let cut = state.cut_short.map(|(id, _)| id);
                state.last_exposed.into_iter().chain(cut).any(|id| id.job == *key)
            }),
            (Self::OtherDevice { boot_id }, Self::OtherDevice { boot_id: known }) => boot_id == known,
            (Self::Left { job, .. }, Self::Left { job: known, .. }) => job == known,
            (Self::Raised { from_um }, Self::Raised { from_um: known }) => from_um == known,
            _ => false,
        })
    }
}

impl fmt::Display for Sign {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exposure { trace: Trace::Lit { layer, .. } | Trace::Held { layer, .. }, seen, job } => {
                match seen {
                    Seen::LastExposed => write!(f, "the device last exposed layer {layer}")?,
                    Seen::CutShort => write!(f, "the device cut short the light of layer {layer}")?,
                    Seen::Exposing => write!(f, "the device is exposing layer {layer}")?,
                    Seen::InSlot => write!(f, "the device holds layer {layer}")?,
                }
                match job {
                    Some(job) => write!(f, " of job {job}, whose journal has no record of it"),
                    None => write!(f, " of a job this spool does not know"),
                }
            }
            Self::Low { position_um, clear_um, .. } => write!(
                f,
                "the plate is {} above the vat, below the clear height of {} (`layerctl raise` lifts it)",
                mm_text(*position_um),
                mm_text(*clear_um)
            ),
            Self::Deep { position_um, .. } => write!(
                f,
                "the plate is {} below the working plane, and its bed may hold a part",
                mm_text(*position_um)
            ),
            Self::Raised { from_um } => {
                write!(f, "the plate was raised from {} above the vat, and may carry a part", mm_text(*from_um))
            }
            Self::OtherDevice { .. } => f.write_str(
                "the plate was found empty before the device was exchanged or restarted, and this device has exposed another job",
            ),
            Self::Left { job, .. } => write!(f, "no record says that the plate was lifted at the end of job {job}"),
        }
    }
}

/// What to do and the signs, as one text. Of each job only the first exposure is named.
pub(crate) fn text(signs: &[Sign], job: u32) -> String {
    let mut keys = Vec::new();
    let is_new = |sign: &&Sign| match sign {
        Sign::Exposure { trace: Trace::Lit { job, .. } | Trace::Held { job, .. }, .. } => {
            let is_new = !keys.contains(job);
            keys.push(*job);
            is_new
        }
        Sign::Low { .. } | Sign::Deep { .. } | Sign::Raised { .. } | Sign::OtherDevice { .. } | Sign::Left { .. } => {
            true
        }
    };
    let signs: Vec<_> = signs.iter().filter(is_new).map(ToString::to_string).collect();
    format!(
        "waits for an empty plate: look at the machine, take out what is there, then `layerctl resume {job}`. Why: {}",
        signs.join("; ")
    )
}

/// The exposures that a device shows, and where.
pub(crate) fn traces(state: &DeviceState) -> Vec<(Trace, Seen)> {
    let lit = |id: ExposureId| Trace::Lit { job: id.job, layer: id.layer };
    let held = |id: ExposureId| Trace::Held { job: id.job, layer: id.layer };
    let slots = state.slots.iter().flatten().map(|id| (held(*id), Seen::InSlot));
    let shown = [
        (state.exposing, Seen::Exposing),
        (state.last_exposed, Seen::LastExposed),
        (state.cut_short.map(|(id, _)| id), Seen::CutShort),
    ];
    shown.into_iter().filter_map(|(id, seen)| Some((lit(id?), seen))).chain(slots).collect()
}
