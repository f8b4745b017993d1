//! What became of a layer that was commanded but not confirmed, judged by the device's state.
//!
//! ```
//! use layerd::job::{Fate, Unconfirmed, fate};
//! use layerd::link::message::{DeviceState, ExposureId};
//!
//! let id = ExposureId::first_pass(7, 3);
//! let commanded = Some(Unconfirmed { exposure: 3, boot_id: 1 });
//! let device = DeviceState { boot_id: 1, last_exposed: Some(id), ..DeviceState::default() };
//! assert_eq!(fate(id, commanded, Some(2000), false, &device), Fate::Exposed);
//! ```

use super::Unconfirmed;
use crate::link::message::{DeviceState, ExposureId};

/// What became of a layer that was commanded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It was exposed for its whole time.
    Exposed,
    /// It had no light.
    NotExposed,
    /// It was marked in part.
    Partly {
        /// The first vector that is not marked whole.
        next_vector: u32,
        /// Whether part of that vector is marked. Says what is known.
        broken: Option<String>,
    },
    /// Only the operator can tell. Says what is known.
    Unknown(String),
}

/// Judges the layer `id` by the state of a device at rest. `commanded` is its command, unless the journal has the layer in doubt
/// already; `exposure_ms` is its time of light, if that is known. `shone` says that a state showed the layer being exposed.
pub fn fate(
    id: ExposureId,
    commanded: Option<Unconfirmed>,
    exposure_ms: Option<u32>,
    shone: bool,
    device: &DeviceState,
) -> Fate {
    if device.last_exposed == Some(id) {
        return Fate::Exposed;
    }
    if let Some(powder) = device.powder.filter(|_| device.cut_short.is_some_and(|(cut, _)| cut == id)) {
        let next_vector = powder.next_vector;
        let broken = powder.broken.then(|| format!("its laser went off within vector {next_vector}"));
        return Fate::Partly { next_vector, broken };
    }
    if let Some((_, light_ms)) = device.cut_short.filter(|(cut, _)| *cut == id) {
        let whole = exposure_ms.map_or_else(String::new, |exposure_ms| format!(" of {exposure_ms} ms"));
        return Fate::Unknown(format!("its light was cut short after {light_ms} ms{whole}"));
    }
    if device.last_exposed.is_some_and(|last| last.job == id.job && last > id) {
        return Fate::Unknown("the device says it exposed a later layer".into());
    }
    match commanded {
        Some(commanded) if commanded.boot_id == device.boot_id && shone => {
            Fate::Unknown("the device exposed it and does not say how that ended".into())
        }
        Some(commanded) if commanded.boot_id == device.boot_id => Fate::NotExposed,
        Some(_) => Fate::Unknown("the device was reset between the command and its end".into()),
        None => Fate::Unknown("the device does not know either".into()),
    }
}
