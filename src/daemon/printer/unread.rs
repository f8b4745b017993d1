//! Journals that could not be read when the daemon started: a disk may fail for a while. They are tried again, so that their jobs can
//! go on, and orders that they hold are carried out, once the disk works. `tests/simulation/seeds.rs` shows it.

use super::Printer;
use crate::daemon::background::Background;
use crate::daemon::jobs::job::Job;
use crate::job::JobDirectory;
use crate::system::spawn_blocking;

/// Pause between two tries. A failed try writes nothing to the log.
const RETRY_US: u64 = 10_000_000;

/// When such journals are tried again.
#[derive(Debug, Default)]
pub(crate) struct Unread {
    retry_us: u64,
    /// Whether a try is under way.
    is_reading: bool,
}

impl Unread {
    /// Has the next try begin soon: a journal was found to be readable, or an operator asks for its job.
    pub(crate) fn hurry(&mut self) {
        self.retry_us = 0;
    }
}

impl Printer {
    /// Tries again to read the journals that could not be read, in the background.
    pub(super) fn retry_unread(&mut self) {
        let now_us = self.clock.now_us();
        if self.unread.is_reading || now_us < self.unread.retry_us {
            return;
        }
        let jobs: Vec<JobDirectory> = self.jobs.unread().cloned().collect();
        if jobs.is_empty() {
            return;
        }
        self.unread = Unread { retry_us: now_us + RETRY_US, is_reading: true };
        let (awaits_plate, background) = (self.setting.machine.confirm_plate(), self.background.clone());
        spawn_blocking(move || {
            let jobs = jobs.into_iter().filter_map(|job| Job::read_again(job, awaits_plate)).collect();
            let _ = background.blocking_send(Background::ReadAgain { jobs });
        });
    }

    /// Takes in the jobs whose journals can be read now.
    pub(super) fn read_again(&mut self, jobs: Vec<Job>) {
        self.unread.is_reading = false;
        for job in jobs {
            let id = job.directory.id;
            // An order may have come meanwhile.
            if !self.jobs.get(id).is_some_and(Job::is_unread) {
                continue;
            }
            self.notice(format!("the journal of job {id} can be read again: the job is {}", job.view.state));
            if job.view.state.is_final() {
                self.jobs_ended += 1;
            } else if job.is_unsampled() {
                self.sampler.want(&job.directory);
            }
            self.jobs.add(job);
            self.publish_job(id);
        }
    }
}
