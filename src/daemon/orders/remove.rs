//! `layerctl remove`: deletes a job that is over, to make room. `tests/orders.rs` tests it.

use std::sync::{Arc, PoisonError};

use crate::api::RemovedView;
use crate::daemon::background::Background;
use crate::daemon::error::OrderError;
use crate::daemon::handle::{Answer, Reply};
use crate::daemon::printer::Printer;
use crate::job::JobState;
use crate::system::spawn_blocking;

impl Printer {
    /// Deletes a finished job in the background.
    pub(crate) fn remove(&mut self, id: &str, reply: Reply) {
        match self.removable(id) {
            Ok(id) => self.delete(id, reply),
            Err(error) => {
                // The client may be gone.
                let _ = reply.send(Err(error));
            }
        }
    }

    fn removable(&mut self, id: &str) -> Result<u32, OrderError> {
        let id = self.find(id)?;
        let state = self.waiting(id)?.view.state;
        if state.is_final() {
            return Ok(id);
        }
        let what = match state {
            JobState::Queued | JobState::Interrupted => format!("`layerctl abort {id}` ends it first"),
            _ => format!("`layerctl stop {id}` or `layerctl abort {id}` ends it first"),
        };
        Err(OrderError::new(409, format!("job {id} is {state}; only a job that is over can be removed: {what}")))
    }

    fn delete(&mut self, id: u32, reply: Reply) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        job.ordered = true;
        let (job, spool, background) = (job.forgotten(), Arc::clone(&self.spool), self.background.clone());
        spawn_blocking(move || {
            let result = spool.lock().unwrap_or_else(PoisonError::into_inner).remove(job);
            let result = result.map_err(|error| error.to_string());
            let _ = background.blocking_send(Background::Removed { job: job.id, result, reply });
        });
    }

    /// Answers once a job was deleted, or could not be.
    pub(crate) fn removed(&mut self, id: u32, result: Result<u64, String>, reply: Reply) {
        let answer = match result {
            Ok(freed_bytes) => {
                self.jobs.forget(&[id]);
                tracing::info!(job = id, freed_bytes, "job removed");
                Ok(Answer::Removed(RemovedView { id: id.to_string(), freed_bytes }))
            }
            Err(text) => {
                if let Some(job) = self.jobs.get_mut(id) {
                    job.ordered = false;
                }
                Err(OrderError::new(500, text))
            }
        };
        self.publish();
        let _ = reply.send(answer);
    }
}
