//! Samples how much resin the parts of new jobs take.
//!
//! The result is known within seconds. One part at a time is sampled, on a thread that works at most a quarter of the time, beside a
//! print and within [`MAX_SAMPLE_BYTES`]. Nothing waits for it. `tests/operator/records.rs` shows the result.

use std::time::Instant;

use tokio::sync::mpsc;

use super::Printer;
use crate::daemon::background::Background;
use crate::daemon::handle::MAX_QUEUED_JOBS;
use crate::daemon::jobs::opened::spool_text;
use crate::daemon::jobs::resin::Resin;
use crate::disk;
use crate::job::JobDirectory;
use crate::pipeline::slab_volumes_mm3;
use crate::system::{self, spawn_blocking};

/// Memory of the sampling, bytes, beside the budget: enough for 180,000 struts at one height.
const MAX_SAMPLE_BYTES: u64 = 8 << 20;
/// Parts that wait to be sampled: every queued job, and as many interrupted ones.
const MAX_WAITING: usize = 2 * MAX_QUEUED_JOBS;
/// The thread rests this many times as long as it works.
const REST: u32 = 3;

/// The task that has parts sampled. It ends when this is dropped.
#[derive(Debug)]
pub(crate) struct Sampler {
    jobs: mpsc::Sender<JobDirectory>,
}

impl Sampler {
    /// Starts the task; [`Background::Sampled`] reports each result.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub(crate) fn start(background: mpsc::Sender<Background>) -> Self {
        let (jobs, mut wanted) = mpsc::channel::<JobDirectory>(MAX_WAITING);
        tokio::spawn(async move {
            while let Some(job) = wanted.recv().await {
                let id = job.id;
                // A panic in the kernels has been reported when it happened.
                let sampled = spawn_blocking(move || sample(&job)).await;
                let result = sampled.unwrap_or_else(|panic| Err(panic.to_string()));
                if background.send(Background::Sampled { job: id, result }).await.is_err() {
                    return;
                }
            }
        });
        Self { jobs }
    }

    /// Has a job's part sampled when its turn comes.
    pub(crate) fn want(&self, job: &JobDirectory) {
        if self.jobs.try_send(job.clone()).is_err() {
            tracing::warn!(
                job = job.id,
                "too many parts wait to be sampled: how much resin this one takes stays unknown"
            );
        }
    }
}

/// Samples a part and notes the result with its job. Blocks.
fn sample(job: &JobDirectory) -> Result<Resin, String> {
    let mut began = Instant::now();
    let rest = || {
        system::rest(began.elapsed() * REST);
        began = Instant::now();
    };
    let slabs_mm3 = slab_volumes_mm3(&job.part(), MAX_SAMPLE_BYTES, rest).map_err(|error| spool_text(&error))?;
    let resin = Resin::of_slabs(&slabs_mm3);
    // A job that was removed meanwhile needs no note.
    if let Err(error) = resin.save(job)
        && disk::exists(&job.journal())
    {
        tracing::warn!(
            job = job.id,
            "how much resin its part takes cannot be noted ({error}); a restart samples it again"
        );
    }
    Ok(resin)
}

impl Printer {
    /// Takes the estimate of a job's part.
    pub(crate) fn sampled(&mut self, id: u32, result: Result<Resin, String>) {
        let Some(job) = self.jobs.get_mut(id) else { return };
        match result {
            Ok(resin) => {
                job.set_resin(resin);
                self.publish_job(id);
            }
            Err(text) => tracing::warn!(job = id, "how much resin its part takes is not known: {text}"),
        }
    }
}
