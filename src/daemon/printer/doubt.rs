//! The layer that an interrupted job commanded and the device did not confirm. Its fate is judged as soon as the device
//! connects, so that the operator learns of a doubt before the job is resumed. `tests/orders.rs` shows it.

use super::Printer;
use crate::job::{Fate, Unconfirmed, fate};
use crate::link::message::{DeviceState, ExposureId};

impl Printer {
    /// Judges the unconfirmed layer by the device's state, while no job runs.
    pub(crate) fn look_at_doubt(&mut self, state: &DeviceState) {
        if state.light_on || state.exposing.is_some() {
            // An exposure is under way; a later state shows how it ended.
            return;
        }
        let Some((id, exposure, commanded)) = self.open_exposure() else { return };
        let exposure_ms = self.jobs.commanded_ms(exposure, commanded.boot_id);
        let why = match fate(exposure, Some(commanded), exposure_ms, self.idle.light.has_shone(exposure), state) {
            Fate::Unknown(why) | Fate::Partly { broken: Some(why), .. } => Some(why),
            Fate::Exposed | Fate::NotExposed | Fate::Partly { broken: None, .. } => None,
        };
        if self.jobs.get_mut(id).is_some_and(|job| job.set_doubt(commanded.exposure, why)) {
            self.publish_job(id);
        }
    }

    /// The interrupted job and its exposure whose end is not confirmed.
    pub(crate) fn open_exposure(&self) -> Option<(u32, ExposureId, Unconfirmed)> {
        let id = self.jobs.interrupted()?;
        let job = self.jobs.get(id)?;
        let commanded = job.past.unconfirmed?;
        Some((id, job.past.passes.id(job.key, commanded.exposure), commanded))
    }
}
