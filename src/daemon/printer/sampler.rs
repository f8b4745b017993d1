//! Samples how much resin the parts of new jobs take.
//!
//! The result is known within seconds. A thread of its own works at most a quarter of the time, beside a print and within
//! [`MAX_SAMPLE_BYTES`]. Nothing waits for it. `tests/operator/records.rs` shows the result.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::Instant;

use tokio::sync::mpsc;

use super::Printer;
use crate::daemon::background::Background;
use crate::daemon::handle::MAX_QUEUED_JOBS;
use crate::daemon::jobs::opened::spool_text;
use crate::daemon::jobs::resin::Resin;
use crate::job::JobDirectory;
use crate::pipeline::slab_volumes_mm3;

/// Memory of the sampling, bytes, beside the budget: enough for 180,000 struts at one height.
const MAX_SAMPLE_BYTES: u64 = 8 << 20;
/// Parts that wait to be sampled: every queued job, and as many interrupted ones.
const MAX_WAITING: usize = 2 * MAX_QUEUED_JOBS;
/// The thread rests this many times as long as it works.
const REST: u32 = 3;

/// The thread that samples parts. It ends when this is dropped.
#[derive(Debug)]
pub(crate) struct Sampler {
    jobs: SyncSender<JobDirectory>,
}

impl Sampler {
    /// Starts the thread; [`Background::Sampled`] reports each result.
    ///
    /// # Errors
    /// The system starts no further thread.
    pub(crate) fn start(background: mpsc::Sender<Background>) -> io::Result<Self> {
        let (jobs, wanted) = sync_channel::<JobDirectory>(MAX_WAITING);
        let work = move || {
            for job in wanted {
                // A panic in the kernels must not end the thread. It has been reported when it happened.
                let sampled = catch_unwind(AssertUnwindSafe(|| sample(&job)));
                let result = sampled.unwrap_or_else(|_| Err("it failed inside".into()));
                if background.blocking_send(Background::Sampled { job: job.id, result }).is_err() {
                    return;
                }
            }
        };
        std::thread::Builder::new().name("resin".into()).spawn(work)?;
        Ok(Self { jobs })
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
        std::thread::sleep(began.elapsed() * REST);
        began = Instant::now();
    };
    let slabs_mm3 = slab_volumes_mm3(&job.part(), MAX_SAMPLE_BYTES, rest).map_err(|error| spool_text(&error))?;
    let resin = Resin::of_slabs(&slabs_mm3);
    // A job that was removed meanwhile needs no note.
    if let Err(error) = resin.save(job)
        && job.journal().exists()
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
