//! What operators order, and what becomes of it.

use std::path::Path;
use std::sync::Arc;

use tokio::sync::oneshot;

use super::api::{InDoubt, JobView};
use super::clock::unix_ms;
use super::handle::{Command, CommandError, Order, Submission};
use super::jobs::Job;
use super::part::{Part, Unprintable};
use super::printer::{Printer, Setting};
use super::running::Background;
use crate::buildfile::BuildFile;
use crate::config::Recipe;
use crate::job::{Command as EngineCommand, JobState, Journal, NewJob, Record, ResumeChoice, Spool, SpoolError};

type Answer = Result<JobView, CommandError>;
type Reply = oneshot::Sender<Answer>;

impl Printer {
    /// Carries an order out and answers it.
    pub(super) fn order(&mut self, order: Order) {
        let Order { command, reply } = order;
        let answer = match command {
            Command::Submit(submission) => return self.submit(submission, reply),
            Command::Pause(id) => self.steer(&id, EngineCommand::Pause),
            Command::Stop(id) => self.steer(&id, EngineCommand::Stop),
            Command::Resume { id, in_doubt } => self.resume(&id, in_doubt),
            Command::Abort(Some(id)) => self.steer(&id, EngineCommand::Abort),
            Command::Abort(None) => match self.running.as_ref().map(|running| running.job).or(self.opening) {
                Some(id) => self.steer(&id.to_string(), EngineCommand::Abort),
                None => Err(CommandError::new(409, "no job is active, so there is nothing to abort")),
            },
        };
        // Whoever asked may have gone.
        let _ = reply.send(answer);
    }

    /// Checks and stores a new job in the background.
    fn submit(&self, submission: Submission, reply: Reply) {
        let (setting, spool) = (Arc::clone(&self.setting), Arc::clone(&self.spool));
        let (background, limit_bytes) = (self.background.clone(), self.budget.limit_bytes());
        tokio::task::spawn_blocking(move || {
            // Before the spool is locked: a large part takes seconds, and the loop that prints needs the spool meanwhile.
            let verified = verify(&submission);
            let result = match spool.lock() {
                Ok(spool) => verified.and_then(|()| accept(&setting, &spool, &submission, limit_bytes)).map(Box::new),
                Err(_) => {
                    Err(CommandError::new(500, "the spool cannot be used after an earlier panic; restart layerd"))
                }
            };
            let _ = background.blocking_send(Background::Accepted { result, reply });
        });
    }

    /// A new job is in the spool, or not.
    pub(super) fn accepted(&mut self, result: Result<Box<Job>, CommandError>, reply: Reply) {
        let answer = result.map(|mut job| {
            // Started with nothing before it, the operator has just seen the plate; behind another job nobody has.
            let alone = self.running.is_none()
                && self.opening.is_none()
                && self.jobs.queue_is_empty()
                && self.jobs.interrupted().is_none();
            job.awaits_plate = self.setting.machine.confirm_plate && !alone;
            let (id, view) = (job.directory.id, job.view.clone());
            self.jobs.accept(*job);
            self.publish_job(id);
            view
        });
        let _ = reply.send(answer);
    }

    /// Pause, stop or abort.
    fn steer(&mut self, id: &str, command: EngineCommand) -> Answer {
        let id = self.find(id)?;
        let now_us = self.clock.now_us();
        if let Some(running) = self.running.as_mut().filter(|running| running.job == id) {
            let state = running.engine.progress().state;
            if !allowed(state, command) {
                return Err(wrong_state(id, state, command));
            }
            running.command(command, now_us);
            let progress = running.engine.progress();
            if let Some(job) = self.jobs.get_mut(id) {
                job.update(&progress);
            }
        } else if self.opening == Some(id) && command == EngineCommand::Abort {
            self.abort_opening = true;
        } else {
            self.end_waiting(id, command)?;
        }
        self.view(id)
    }

    /// Stop or abort of a job that does not hold the machine.
    fn end_waiting(&mut self, id: u32, command: EngineCommand) -> Result<(), CommandError> {
        let Some(job) = self.jobs.get_mut(id) else { return Err(no_such_job(&id.to_string())) };
        let ended = match (job.view.state, command) {
            (JobState::Queued | JobState::Interrupted, EngineCommand::Abort) => JobState::Aborted,
            (JobState::Queued | JobState::Interrupted, EngineCommand::Stop) => JobState::Stopped,
            (state, command) => return Err(wrong_state(id, state, command)),
        };
        let reason = "ended by the operator".to_owned();
        let (mut journal, _) =
            Journal::open(&job.directory.journal()).map_err(|error| CommandError::new(500, error.to_string()))?;
        journal
            .append(Record::Ended { state: ended, reason: reason.clone() }, unix_ms())
            .map_err(|error| CommandError::new(507, error.to_string()))?;
        job.end(ended, Some(reason));
        self.jobs.unqueue(id);
        self.publish_job(id);
        Ok(())
    }

    fn resume(&mut self, id: &str, in_doubt: Option<InDoubt>) -> Answer {
        let id = self.find(id)?;
        let now_us = self.clock.now_us();
        if let Some(running) = self.running.as_mut().filter(|running| running.job == id) {
            let state = running.engine.progress().state;
            if !allowed(state, EngineCommand::Resume) {
                return Err(wrong_state(id, state, EngineCommand::Resume));
            }
            running.command(EngineCommand::Resume, now_us);
            let progress = running.engine.progress();
            if let Some(job) = self.jobs.get_mut(id) {
                job.update(&progress);
            }
            return self.view(id);
        }
        let choice = match in_doubt {
            None => ResumeChoice::None,
            Some(InDoubt::Exposed) => ResumeChoice::AssumeExposed,
            Some(InDoubt::Repeat) => ResumeChoice::Repeat,
        };
        let Some(job) = self.jobs.get_mut(id) else { return Err(no_such_job(&id.to_string())) };
        match job.view.state {
            JobState::Queued if job.awaits_plate => {
                job.awaits_plate = false;
                job.view.reason = None;
            }
            JobState::Interrupted => {
                let history = crate::job::read_journal(&job.directory.journal())
                    .map_err(|error| CommandError::new(500, error.to_string()))?
                    .1;
                history.start(choice).map_err(|error| CommandError::new(409, error.to_string()))?;
                self.jobs.resume(id, choice);
            }
            state => return Err(wrong_state(id, state, EngineCommand::Resume)),
        }
        self.publish_job(id);
        self.view(id)
    }

    fn find(&self, id: &str) -> Result<u32, CommandError> {
        let number = id.parse().ok().filter(|number| self.jobs.get(*number).is_some());
        number.ok_or_else(|| no_such_job(id))
    }

    fn view(&self, id: u32) -> Answer {
        self.jobs.get(id).map(|job| job.view.clone()).ok_or_else(|| no_such_job(&id.to_string()))
    }
}

/// Whether a running job in `state` takes the command.
fn allowed(state: JobState, command: EngineCommand) -> bool {
    use JobState::{Aborting, Checking, Paused, Pausing, Printing, Stopping};
    match command {
        EngineCommand::Pause => matches!(state, Checking | Printing | Pausing),
        EngineCommand::Resume => matches!(state, Pausing | Paused),
        EngineCommand::Stop => matches!(state, Checking | Printing | Pausing | Paused | Stopping),
        EngineCommand::Abort => matches!(state, Checking | Printing | Pausing | Paused | Stopping | Aborting),
    }
}

fn wrong_state(id: u32, state: JobState, command: EngineCommand) -> CommandError {
    let verb = match command {
        EngineCommand::Pause => "paused",
        EngineCommand::Resume => "resumed",
        EngineCommand::Stop => "stopped",
        EngineCommand::Abort => "aborted",
    };
    CommandError::new(409, format!("job {id} is {state} and cannot be {verb}"))
}

fn no_such_job(id: &str) -> CommandError {
    CommandError::new(404, format!("there is no job `{id}`; `layerctl jobs` lists them"))
}

/// Checks a new part from its first byte to its last. Blocks.
fn verify(submission: &Submission) -> Result<(), CommandError> {
    let verified = BuildFile::open(&submission.part).and_then(|file| file.verify());
    verified.map_err(|error| unprintable(submission, &error.to_string()))
}

fn unprintable(submission: &Submission, text: &str) -> CommandError {
    // The operator knows the part by its own name, not by that in the spool.
    CommandError::new(422, text.replace(&submission.part.display().to_string(), &submission.name))
}

/// Checks a new job and puts it into the spool. Blocks.
fn accept(setting: &Setting, spool: &Spool, submission: &Submission, limit_bytes: u64) -> Result<Job, CommandError> {
    let recipe_text = submission.recipe_text.as_deref().unwrap_or(&setting.recipe_text);
    let recipe_place = submission.recipe_name.as_deref().unwrap_or("recipe");
    let recipe = Recipe::parse(Path::new(recipe_place), recipe_text)
        .map_err(|error| CommandError::new(422, error.to_string()))?;
    let part =
        Part::open(&submission.part, &setting.machine, &recipe, setting.threads, limit_bytes).map_err(|error| {
            match error {
                Unprintable::Part(_) | Unprintable::Memory { .. } => unprintable(submission, &error.to_string()),
            }
        })?;
    let key = random_key();
    let layer_count = part.layer_count();
    let accepted = Record::Accepted { key, layer_count, name: submission.name.clone() };
    let job = NewJob {
        part: &submission.part,
        recipe: recipe_text,
        machine: &setting.machine_text,
        accepted,
        at_unix_ms: unix_ms(),
    };
    spool.check_space(0).map_err(|error| spool_error(&error))?;
    let (directory, _journal) = spool.create(job).map_err(|error| spool_error(&error))?;
    Ok(Job::accepted(directory, key, layer_count, submission.name.clone(), recipe.name))
}

fn spool_error(error: &SpoolError) -> CommandError {
    let status = if matches!(error, SpoolError::NoSpace { .. }) { 507 } else { 500 };
    CommandError::new(status, error.to_string())
}

/// A number no other job has: 64 random bits, never 0.
fn random_key() -> u64 {
    use std::hash::{BuildHasher, Hasher};
    // The standard library seeds each of these from the system's random numbers.
    std::collections::hash_map::RandomState::new().build_hasher().finish().max(1)
}
