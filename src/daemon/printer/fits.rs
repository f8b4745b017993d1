//! Whether jobs fit the device that is connected. `tests/strangers.rs` changes the device.

use std::sync::Arc;

use super::Printer;
use crate::daemon::fit::Fit;
use crate::daemon::jobs::job::Job;
use crate::device::check_fit;

impl Printer {
    /// What new jobs are checked against now.
    pub(crate) fn fit(&self) -> Fit {
        Fit::new(Arc::clone(&self.setting), self.capabilities.clone().filter(|_| self.device.connected))
    }

    /// Why the connected device cannot print this job; `None` if it can, or if that is not known yet.
    pub(crate) fn misfit_of(&self, job: &Job) -> Option<String> {
        let device = self.capabilities.as_ref().filter(|_| self.device.connected)?;
        let (machine, recipe) = &**job.made_for.as_ref()?;
        check_fit(machine, recipe, device).err().map(|misfit| misfit.to_string())
    }

    /// The same of a job that has not begun: it waits for a device that fits.
    pub(crate) fn awaits_other_device(&self, job: &Job) -> Option<String> {
        (job.is_to_print() && !job.has_begun()).then(|| self.misfit_of(job)).flatten()
    }
}
