//! What operators order, and what becomes of it.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use super::api::{InDoubt, JobView};
use super::background::{Background, Reply};
use super::clock::unix_ms;
use super::handle::{Command, CommandError, Order, Submission};
use super::jobs::{Job, TakeUp};
use super::part::Part;
use super::printer::Printer;
use super::setting::Setting;
use crate::buildfile::BuildFile;
use crate::config::Recipe;
use crate::device::{Misfit, check_fit};
use crate::job::{
    Command as EngineCommand, JobState, Journal, JournalError, NewJob, Record, ResumeChoice, Spool, SpoolError,
    read_journal,
};
use crate::link::message::{Capabilities, Urgent};
use crate::random;

/// What an operator wants of a job that does not hold the machine, where its journal has a say.
#[derive(Clone, Copy, Debug)]
pub(super) enum Change {
    /// Stop or abort it; one that has begun needs the machine for that.
    End(EngineCommand),
    /// Abort it though it cannot be given the machine.
    Close,
    /// Print an interrupted job further.
    Resume(ResumeChoice),
}

/// What the journal made of a change.
#[derive(Debug)]
pub(super) enum Settled {
    /// The job is over, for that reason.
    Ended(JobState, String),
    /// It is taken up as soon as the machine is free.
    TakenUp(TakeUp),
}

/// How far an order came at once.
enum Step {
    /// Done; the job's view is the answer.
    Done(u32),
    /// The journal must be asked or told first.
    Change(u32, Change),
}

const ENDED: &str = "ended by the operator";
const CLOSED: &str =
    "ended by the operator; the part could not be opened, so the plate was not lifted: see to plate and light";

impl Printer {
    /// Carries an order out and answers it.
    pub(super) fn order(&mut self, order: Order) {
        let Order { command, reply } = order;
        if self.shutting_down && matches!(command, Command::Submit(_) | Command::Resume { .. }) {
            let _ = reply.send(Err(CommandError::new(503, "the daemon is ending and begins nothing more")));
            return;
        }
        let step = match command {
            Command::Submit(submission) => return self.submit(submission, reply),
            Command::Pause(id) => self.steer(&id, EngineCommand::Pause),
            Command::Stop(id) => self.steer(&id, EngineCommand::Stop),
            Command::Resume { id, in_doubt } => self.resume(&id, in_doubt),
            Command::Abort(Some(id)) => self.steer(&id, EngineCommand::Abort),
            Command::Abort(None) => {
                match self.holder().or_else(|| self.jobs.interrupted()).or_else(|| self.jobs.ending()) {
                    Some(id) => self.steer(&id.to_string(), EngineCommand::Abort),
                    None => {
                        // Light without a job is not for the daemon to explain, but to end.
                        self.send_urgent(Urgent::Abort);
                        let text = "no job is active, so there is nothing to abort; the device was told to go dark all the same";
                        Err(CommandError::new(409, text))
                    }
                }
            }
        };
        let answer = match step {
            Ok(Step::Change(id, change)) => return self.change(id, change, reply),
            Ok(Step::Done(id)) => self.view(id),
            Err(error) => Err(error),
        };
        // Whoever asked may have gone.
        let _ = reply.send(answer);
    }

    /// Checks and stores a new job in the background.
    fn submit(&self, submission: Submission, reply: Reply) {
        let (setting, spool) = (Arc::clone(&self.setting), Arc::clone(&self.spool));
        let jobs_ended = submission.jobs_ended;
        let (background, limit_bytes) = (self.background.clone(), self.budget.limit_bytes());
        let device = self.capabilities.clone().filter(|_| self.device.connected);
        // Beside a print there is no memory for it; the job is looked at before it begins in any case.
        let looks = self.is_idle();
        tokio::task::spawn_blocking(move || {
            let fits = check_device(&setting, &submission, device.as_ref());
            let verified = fits.and_then(|()| verify(&submission));
            let result =
                verified.and_then(|()| accept(&setting, &spool, &submission, limit_bytes, looks)).map(Box::new);
            let _ = background.blocking_send(Background::Accepted { result, jobs_ended, reply });
        });
    }

    /// A new job is in the spool, or not.
    pub(super) fn accepted(&mut self, result: Result<Box<Job>, CommandError>, jobs_ended: u64, reply: Reply) {
        let answer = result.map(|job| {
            let id = job.directory.id;
            self.jobs.accept(*job);
            // Started with nothing before it, the operator has just seen the plate. Nobody has behind another job, not even
            // one that ended while this one arrived, nor where who asked did not wait for the answer.
            let is_next = self.jobs.ahead_of(id, self.holder()).is_none();
            let is_seen = jobs_ended == self.jobs_ended && !reply.is_closed() && is_next;
            if let Some(job) = self.jobs.get_mut(id) {
                job.awaits_plate = self.part_in_vat || (self.setting.machine.confirm_plate && !is_seen);
            }
            self.publish_job(id);
            id
        });
        let _ = reply.send(answer.and_then(|id| self.view(id)));
    }

    /// Pause, stop or abort.
    fn steer(&mut self, id: &str, command: EngineCommand) -> Result<Step, CommandError> {
        let id = self.find(id)?;
        if self.command_running(id, command)? {
            return Ok(Step::Done(id));
        }
        let (is_opening, holder) = (self.opening == Some(id), self.holder());
        let job = self.known(id)?;
        let state = job.view.state;
        let ends = match command {
            EngineCommand::Abort => !state.is_final(),
            EngineCommand::Stop => !state.is_final() && state != JobState::Aborting,
            EngineCommand::Pause | EngineCommand::Resume => false,
        };
        if !ends {
            return Err(wrong_state(id, state, command));
        }
        if is_opening {
            job.take_up = TakeUp::End(command);
            job.view.state = job.take_up.state_before(state);
        }
        let is_abort = command == EngineCommand::Abort;
        let comes_next = is_abort && job.ordered;
        job.abort_ordered |= comes_next;
        let has_begun = job.has_begun();
        if is_abort && has_begun && holder.is_none_or(|holder| holder == id) {
            // Its light first, before any disk is asked.
            self.send_urgent(Urgent::Abort);
        }
        if is_opening || comes_next {
            return Ok(Step::Done(id));
        }
        if self.shutting_down {
            return Err(CommandError::new(503, "the daemon is ending; end the job when it runs again"));
        }
        self.waiting(id)?;
        Ok(Step::Change(id, Change::End(command)))
    }

    fn resume(&mut self, id: &str, in_doubt: Option<InDoubt>) -> Result<Step, CommandError> {
        let id = self.find(id)?;
        if self.command_running(id, EngineCommand::Resume)? {
            return Ok(Step::Done(id));
        }
        let choice = match in_doubt {
            None => ResumeChoice::None,
            Some(InDoubt::Exposed) => ResumeChoice::AssumeExposed,
            Some(InDoubt::Repeat) => ResumeChoice::Repeat,
        };
        let job = self.waiting(id)?;
        let (state, awaits_plate) = (job.view.state, job.awaits_plate);
        match state {
            JobState::Queued if awaits_plate || self.setting.machine.confirm_plate => self.plate_is_clear(id),
            JobState::Interrupted => Ok(Step::Change(id, Change::Resume(choice))),
            state => Err(wrong_state(id, state, EngineCommand::Resume)),
        }
    }

    /// The operator's word for a queued job. It counts only once the job is next: whoever says it earlier cannot have looked.
    fn plate_is_clear(&mut self, id: u32) -> Result<Step, CommandError> {
        if let Some(ahead) = self.jobs.ahead_of(id, self.holder()) {
            let text = format!("job {id} {ahead}; what is on the plate then is not known yet");
            return Err(CommandError::new(409, text));
        }
        self.waiting(id)?.awaits_plate = false;
        self.part_in_vat = false;
        self.publish_job(id);
        Ok(Step::Done(id))
    }

    /// A change ordered by an operator who has had the answer already.
    pub(super) fn change_unasked(&mut self, id: u32, change: Change) {
        let (reply, _) = tokio::sync::oneshot::channel();
        self.change(id, change, reply);
    }

    /// Gives the order to the engine if the job is the running one; says whether it is.
    fn command_running(&mut self, id: u32, command: EngineCommand) -> Result<bool, CommandError> {
        let now_us = self.clock.now_us();
        let Some(running) = self.running.as_mut().filter(|running| running.job == id) else { return Ok(false) };
        let state = running.engine.progress().state;
        if !allowed(state, command) {
            return Err(wrong_state(id, state, command));
        }
        running.command(command, now_us);
        let progress = running.engine.progress();
        if let Some(job) = self.jobs.get_mut(id) {
            job.update(&progress);
        }
        Ok(true)
    }

    /// Asks or tells the journal of a job that does not hold the machine, in the background.
    fn change(&mut self, id: u32, change: Change, reply: Reply) {
        let Some(job) = self.jobs.get_mut(id) else {
            let _ = reply.send(Err(no_such_job(&id.to_string())));
            return;
        };
        job.ordered = true;
        let (journal, background) = (job.directory.journal(), self.background.clone());
        tokio::task::spawn_blocking(move || {
            let result = settle_in_journal(&journal, change);
            let _ = background.blocking_send(Background::Changed { job: id, result, reply });
        });
    }

    /// The journal allows the change and says so, or not.
    pub(super) fn changed(&mut self, id: u32, result: Result<Settled, CommandError>, reply: Reply) {
        let mut abort = false;
        if let Some(job) = self.jobs.get_mut(id) {
            job.ordered = false;
            abort = std::mem::take(&mut job.abort_ordered) && !matches!(result, Ok(Settled::Ended(..)));
            match &result {
                Ok(Settled::Ended(state, reason)) => {
                    let is_left = job.has_begun() && *state != JobState::Completed;
                    self.jobs_ended += 1;
                    job.end(*state, Some(reason.clone()));
                    self.jobs.unqueue(id);
                    if is_left {
                        self.leave_part_in_vat();
                    }
                }
                Ok(Settled::TakenUp(take_up)) => self.jobs.take_up(id, *take_up),
                Err(_) => {}
            }
        }
        self.publish_job(id);
        if let (Err(error), true) = (&result, reply.is_closed()) {
            self.notice(format!("an order for job {id} could not be carried out: {}", error.message));
        }
        let _ = reply.send(result.and_then(|_| self.view(id)));
        if abort {
            self.change_unasked(id, Change::End(EngineCommand::Abort));
        }
    }

    fn known(&mut self, id: u32) -> Result<&mut Job, CommandError> {
        self.jobs.get_mut(id).ok_or_else(|| no_such_job(&id.to_string()))
    }

    /// A job that no other order is being carried out on.
    fn waiting(&mut self, id: u32) -> Result<&mut Job, CommandError> {
        let job = self.known(id)?;
        if job.ordered {
            let text = format!("another order for job {id} is being carried out; look at it and try again");
            return Err(CommandError::new(409, text));
        }
        Ok(job)
    }

    fn find(&self, id: &str) -> Result<u32, CommandError> {
        let number = id.parse().ok().filter(|number| self.jobs.get(*number).is_some());
        number.ok_or_else(|| no_such_job(id))
    }

    fn view(&self, id: u32) -> Result<JobView, CommandError> {
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

/// Checks a change against the job's journal and writes there what must be known after a crash. Blocks.
fn settle_in_journal(path: &Path, change: Change) -> Result<Settled, CommandError> {
    let unreadable = |error: JournalError| CommandError::new(500, error.to_string());
    let history = match read_journal(path) {
        Ok((_, history)) => history,
        // The operator must get rid of it; after a restart it comes back for as long as it cannot be read.
        Err(error) if matches!(change, Change::End(EngineCommand::Abort)) => {
            let reason = format!("{ENDED}, but {error}: the plate was not lifted; see to plate and light");
            return Ok(Settled::Ended(JobState::Aborted, reason));
        }
        Err(error) => return Err(unreadable(error)),
    };
    if history.state.is_final() {
        // It could not be read when the daemon started.
        return Ok(Settled::Ended(history.state, history.reason));
    }
    let (command, reason) = match change {
        Change::Resume(choice) => {
            history.start(choice).map_err(|error| CommandError::new(409, error.to_string()))?;
            return Ok(Settled::TakenUp(TakeUp::Print(choice)));
        }
        Change::End(command) if history.state != JobState::Queued => {
            return Ok(Settled::TakenUp(TakeUp::End(command)));
        }
        Change::End(command) => (command, ENDED),
        Change::Close => (EngineCommand::Abort, CLOSED),
    };
    let state = if command == EngineCommand::Abort { JobState::Aborted } else { JobState::Stopped };
    let ended = Record::Ended { state, reason: reason.into() };
    let written = Journal::open(path).and_then(|(mut journal, _)| journal.append(ended, unix_ms()));
    match (written, change) {
        (Ok(()), _) => Ok(Settled::Ended(state, reason.into())),
        (Err(error), Change::Close) => Ok(Settled::Ended(state, format!("{reason}. A restart forgets this: {error}"))),
        (Err(error), _) => Err(CommandError::new(507, error.to_string())),
    }
}

/// Checks that the connected device can print the new job; without one that is left to the job's beginning.
fn check_device(setting: &Setting, submission: &Submission, device: Option<&Capabilities>) -> Result<(), CommandError> {
    let (recipe, _) = recipe_of(setting, submission)?;
    let Some(device) = device else { return Ok(()) };
    check_fit(&setting.machine, &recipe, device).map(|_| ()).map_err(|misfit| {
        // Another device will do, or another recipe.
        let status = if matches!(misfit, Misfit::Machine(_)) { 409 } else { 422 };
        CommandError::new(status, misfit.to_string())
    })
}

/// The recipe of a new job, and its text.
fn recipe_of<'a>(setting: &'a Setting, submission: &'a Submission) -> Result<(Recipe, &'a str), CommandError> {
    let text = submission.recipe_text.as_deref().unwrap_or(&setting.recipe_text);
    let place = submission.recipe_name.as_deref().unwrap_or("recipe");
    let recipe = Recipe::parse(Path::new(place), text).map_err(|error| CommandError::new(422, error.to_string()))?;
    Ok((recipe, text))
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

/// Checks a new job, its bottom layers too where `looks`, and puts it into the spool. Blocks.
fn accept(
    setting: &Setting,
    spool: &Mutex<Spool>,
    submission: &Submission,
    limit_bytes: u64,
    looks: bool,
) -> Result<Job, CommandError> {
    let (recipe, recipe_text) = recipe_of(setting, submission)?;
    let part = Part::open(&submission.part, &setting.machine, &recipe, setting.threads, limit_bytes)
        .map_err(|error| unprintable(submission, &error.to_string()))?;
    if looks {
        part.check_footing(&recipe, limit_bytes).map_err(|error| unprintable(submission, &error.to_string()))?;
    }
    // 0 names no job.
    let key = random::bits().max(1);
    let layer_count = part.layer_count();
    let accepted = Record::Accepted { key, layer_count, name: submission.name.clone() };
    let job = NewJob {
        part: &submission.part,
        recipe: recipe_text,
        machine: &setting.machine_text,
        accepted,
        at_unix_ms: unix_ms(),
    };
    // A panic elsewhere leaves the spool as it was: jobs appear whole or not at all.
    let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
    spool.check_space(0).map_err(|error| spool_error(&error))?;
    let (directory, _journal) = spool.create(job).map_err(|error| spool_error(&error))?;
    Ok(Job::accepted(directory, key, layer_count, submission.name.clone(), recipe.name))
}

fn spool_error(error: &SpoolError) -> CommandError {
    let status = if matches!(error, SpoolError::NoSpace { .. }) { 507 } else { 500 };
    CommandError::new(status, error.to_string())
}
