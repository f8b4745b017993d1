//! A new job: checked against machine, recipe and device, and put into the spool.
//! `tests/control_api/uploads.rs` and `tests/strangers.rs` test it.

use std::sync::{Arc, Mutex, PoisonError};

use crate::api::JobView;
use crate::config::Recipe;
use crate::daemon::background::Background;
use crate::daemon::error::OrderError;
use crate::daemon::handle::{Reply, Submission};
use crate::daemon::jobs::job::Job;
use crate::daemon::jobs::opened::spool_text;
use crate::daemon::printer::Printer;
use crate::daemon::setting::Setting;
use crate::job::{JobState, JournalError, NewJob, Record, Spool, SpoolError};
use crate::pipeline::{PartError, Placed, Resolution};
use crate::random;
use crate::system::{spawn_blocking, unix_ms};

impl Printer {
    /// Checks and stores a new job in the background.
    pub(crate) fn submit(&self, submission: Submission, reply: Reply) {
        self.take_in(submission.jobs_ended, move || Ok(submission), ToString::to_string, reply);
    }

    /// The same of a job that `receive` makes, which may block. `jobs_ended` is that of the submission; `words` says what is wrong
    /// with a part that cannot be read.
    pub(crate) fn take_in(
        &self,
        jobs_ended: u64,
        receive: impl FnOnce() -> Result<Submission, OrderError> + Send + 'static,
        words: fn(&PartError) -> String,
        reply: Reply,
    ) {
        let (setting, spool) = (Arc::clone(&self.setting), Arc::clone(&self.spool));
        let (background, limit_bytes) = (self.background.clone(), self.budget.limit_bytes());
        let fit = self.fit();
        // During a print there is no memory for these checks. They are repeated in any case before the job begins.
        let checks_layers = self.is_idle();
        let under_way = Arc::clone(&self.accepting);
        spawn_blocking(move || {
            // The file of a refused part is deleted before the answer.
            let result = receive().and_then(|submission| {
                let recipe = fit.check(submission.recipe_text.as_deref(), submission.recipe_name.as_deref())?;
                accept(&setting, &spool, &submission, &recipe, limit_bytes, checks_layers, words).map(Box::new)
            });
            let _ = background.blocking_send(Background::Accepted { result, jobs_ended, reply, under_way });
        });
    }

    /// Queues a job that was put into the spool, or answers why it was not.
    pub(crate) fn accepted(&mut self, result: Result<Box<Job>, OrderError>, jobs_ended: u64, reply: Reply) {
        let answer = result.map(|job| {
            let id = job.directory.id;
            if job.is_unsampled() {
                self.sampler.want(&job.directory);
            }
            self.jobs.accept(*job);
            // The operator has seen the plate only if this job is next, no job ended while it arrived, and the client still waits
            // for the answer. A job needs a confirmation otherwise.
            let is_next = self.jobs.ahead_of(id, self.holder()).is_none();
            let is_seen = jobs_ended == self.jobs_ended && !reply.is_closed() && is_next;
            if let Some(job) = self.jobs.get_mut(id) {
                job.awaits_plate = self.setting.machine.confirm_plate() && !is_seen;
            }
            self.publish_job(id);
            id
        });
        let _ = reply.send(answer.and_then(|id| {
            // Before it moves.
            let begins = self.begins_text(id);
            if let Some(text) = &begins {
                self.tell(text.clone());
            }
            self.view(id, begins)
        }));
    }

    /// Says that a new job waits for nothing, and what is assumed of the plate; `None` if it waits.
    fn begins_text(&self, id: u32) -> Option<String> {
        let job = self.jobs.get(id).filter(|job| job.view.reason.is_none())?;
        let when = if self.device.connected { "at once" } else { "once a device answers" };
        let last = self.jobs.last_over().map_or_else(String::new, |last| {
            let JobView { id, state, .. } = last;
            let was = if matches!(state, JobState::Aborted | JobState::Stopped) { "was " } else { "" };
            format!(" (the last job, {id}, {was}{state})")
        });
        Some(format!("job {} begins {when}: the plate is taken to be empty{last}", job.view.id))
    }
}

fn unprintable(submission: &Submission, text: &str) -> OrderError {
    // The operator knows the part by its own name, not by its path in the spool.
    OrderError::new(422, text.replace(&submission.part.display().to_string(), &submission.name))
}

/// Checks a new job, including how far its patches reach and its bottom layers if `checks_layers` is set, and puts it into the spool. Blocks.
fn accept(
    setting: &Setting,
    spool: &Mutex<Spool>,
    submission: &Submission,
    recipe: &Recipe,
    limit_bytes: u64,
    checks_layers: bool,
    words: fn(&PartError) -> String,
) -> Result<Job, OrderError> {
    let part = Placed::open(&submission.part, &Resolution::of(&setting.machine, recipe))
        .and_then(|placed| placed.fit(setting.threads, limit_bytes))
        .and_then(|part| part.verify(checks_layers.then_some(limit_bytes)).map(|()| part))
        .map_err(|error| unprintable(submission, &words(&error)))?;
    if checks_layers {
        let footing =
            part.footing(recipe, limit_bytes).map_err(|error| unprintable(submission, &spool_text(&error)))?;
        footing.problem(part.layer_count()).map_or(Ok(()), |problem| Err(unprintable(submission, &problem)))?;
    }
    // 0 names no job.
    let key = random::bits().max(1);
    let passes = part.passes();
    let accepted = Record::Accepted { key, layer_count: passes.layer_count(), name: submission.name.clone() };
    let job = NewJob {
        part: &submission.part,
        recipe: submission.recipe_text.as_deref().unwrap_or(&setting.recipe_text),
        machine: &setting.machine_text,
        accepted,
        passes: &passes,
        at_unix_ms: unix_ms(),
    };
    // A panic elsewhere cannot leave half a job: jobs appear in the spool whole or not at all.
    let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
    spool.check_space(0).map_err(|error| spool_error(&error))?;
    let (directory, journal) = spool.create(job).map_err(|error| spool_error(&error))?;
    if !journal.is_reserved() {
        tracing::warn!(
            job = directory.id,
            "the spool's file system sets no room aside (fallocate): a full disk can keep the job's end from being written"
        );
    }
    let (name, machine) = (submission.name.clone(), setting.machine.clone());
    Ok(Job::accepted(directory, key, passes, name, machine, recipe.clone()))
}

pub(super) fn spool_error(error: &SpoolError) -> OrderError {
    let is_full = match error {
        SpoolError::NoSpace { .. } => true,
        SpoolError::Io { source, .. } | SpoolError::Journal(JournalError::Io { source, .. }) => {
            source.kind() == std::io::ErrorKind::StorageFull
        }
        _ => false,
    };
    let status = if is_full { 507 } else { 500 };
    OrderError::new(status, error.to_string())
}
