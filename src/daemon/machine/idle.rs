//! What is known of the device while no job runs. `tests/interrupted.rs` shows light without a job.

use super::raise::Raise;
use crate::device::{FramedDriver, LightWatch};

/// What is known of the device while no job runs.
#[derive(Default)]
pub(crate) struct Idle {
    /// Queries the device's state; `None` without a session, or while a job runs.
    pub driver: Option<FramedDriver>,
    /// Watches its light. While a job runs, the job's engine does.
    pub light: LightWatch,
    /// When the exposure under way must have ended.
    pub light_due_us: Option<u64>,
    /// The move of `layerctl raise`, while it is under way.
    pub raise: Option<Raise>,
}

impl Idle {
    /// The state after a job: the watch on the light goes on; there is no session yet.
    pub(crate) fn after(light: LightWatch) -> Self {
        Self { light, ..Self::default() }
    }

    /// When the next of its deadlines is due.
    pub(crate) fn next_timeout_us(&self) -> Option<u64> {
        let driver = self.driver.as_ref().and_then(FramedDriver::next_timeout_us);
        let raised = self.raise.as_ref().map(|raise| raise.deadline.at_us());
        driver.into_iter().chain(self.light_due_us).chain(raised).min()
    }
}
