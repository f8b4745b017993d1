//! What operators order, and what becomes of it.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use super::api::{InDoubt, JobView};
use super::background::{Background, Reply};
use super::clock::unix_ms;
use super::handle::{Answer, Command, CommandError, Order, Submission};
use super::jobs::{Job, TakeUp};
use super::part::Part;
use super::printer::Printer;
use super::setting::Setting;
use crate::buildfile::BuildFile;
use crate::config::Recipe;
use crate::device::{Misfit, check_fit};
use crate::job::{
    Command as EngineCommand, EndOrder, JobState, Journal, JournalError, NewJob, Record, ResumeChoice, ResumeError,
    Spool, SpoolError, read_journal,
};
use crate::link::message::{Capabilities, Urgent};
use crate::random;

/// What an operator wants of a job that does not hold the machine, where its journal has a say.
#[derive(Clone, Copy, Debug)]
pub(super) enum Change {
    /// Stop or abort it; one that has begun needs the machine for that.
    End(EndOrder),
    /// Abort it though it cannot be given the machine.
    Close,
    /// Print an interrupted job further.
    Resume(ResumeChoice),
}

/// What the journal made of a change, and what went wrong although it is carried out.
#[derive(Debug)]
pub(super) struct Settled {
    outcome: Outcome,
    warning: Option<String>,
}

/// What becomes of a job that was changed.
#[derive(Debug)]
enum Outcome {
    /// The job is over, for that reason.
    Ended(JobState, String),
    /// It is taken up as soon as the machine is free.
    TakenUp(TakeUp),
}

/// How far an order came at once.
pub(super) enum Step {
    /// Done; the job's view is the answer.
    Done(u32),
    /// The job's engine carries it out; its record is on the way to the disk.
    Unwritten(u32, EndOrder),
    /// An order for the job is being written already; this one comes next.
    Next(u32),
    /// The journal must be asked or told first.
    Change(u32, Change),
}

/// An order that is being carried out and is answered once it is on disk.
#[derive(Debug)]
pub(super) struct Unwritten {
    job: u32,
    order: EndOrder,
    reply: Reply,
    /// A disk that takes longer than this keeps nobody waiting.
    until_us: u64,
}

/// The slowest memory cards flush within a second; an operator who aborts is not kept waiting longer for a disk.
const LONGEST_WRITE_US: u64 = 1_500_000;

/// Why a job ended that had not begun.
fn unbegun(order: EndOrder) -> &'static str {
    match order {
        EndOrder::Abort => "aborted by the operator before it began",
        EndOrder::Stop => "stopped by the operator before it began",
    }
}

const ENDED: &str = "ended by the operator";
const CLOSED: &str =
    "ended by the operator; the part could not be opened, so the plate was not lifted: see to plate and light";

impl Printer {
    /// Carries an order out and answers it.
    pub(super) fn order(&mut self, order: Order) {
        let Order { command, reply } = order;
        if self.shutting_down && matches!(command, Command::Submit(_) | Command::Resume { .. } | Command::Remove(_)) {
            let _ = reply.send(Err(CommandError::new(503, "the daemon is ending and begins nothing more")));
            return;
        }
        let step = match command {
            Command::Submit(submission) => return self.submit(submission, reply),
            Command::Remove(id) => return self.remove(&id, reply),
            Command::Raise => {
                let _ = reply.send(self.raise());
                return;
            }
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
            Ok(Step::Next(id)) => {
                if let Some(job) = self.jobs.get_mut(id) {
                    job.aborts.push(reply);
                }
                return;
            }
            Ok(Step::Unwritten(job, order)) => {
                let until_us = self.clock.now_us() + LONGEST_WRITE_US;
                return self.unwritten.push(Unwritten { job, order, reply, until_us });
            }
            Ok(Step::Done(id)) => {
                // Before the answer: one who asks again at once must not see how it was before.
                self.publish_job(id);
                self.view(id, None)
            }
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
                job.awaits_plate = self.setting.machine.confirm_plate && !is_seen;
            }
            self.publish_job(id);
            id
        });
        let _ = reply.send(answer.and_then(|id| self.view(id, None)));
    }

    /// Pause, stop or abort.
    fn steer(&mut self, id: &str, command: EngineCommand) -> Result<Step, CommandError> {
        let id = self.find(id)?;
        let end = match command {
            EngineCommand::Abort => Some(EndOrder::Abort),
            EngineCommand::Stop => Some(EndOrder::Stop),
            EngineCommand::Pause | EngineCommand::Resume => None,
        };
        if self.command_running(id, command)? {
            return Ok(end.map_or(Step::Done(id), |order| Step::Unwritten(id, order)));
        }
        let (is_opening, holder) = (self.opening == Some(id), self.holder());
        let job = self.known(id)?;
        let state = job.view.state;
        let ends = match command {
            EngineCommand::Abort => !state.is_final(),
            EngineCommand::Stop => !state.is_final() && state != JobState::Aborting,
            EngineCommand::Pause | EngineCommand::Resume => false,
        };
        let Some(order) = end.filter(|_| ends) else { return Err(wrong_state(id, state, command)) };
        if is_opening {
            job.take_up = TakeUp::End(command);
            job.view.state = job.take_up.state_before(state);
        }
        let is_abort = order == EndOrder::Abort;
        let (comes_next, has_begun) = (is_abort && job.ordered, job.has_begun());
        if is_abort && has_begun && holder.is_none_or(|holder| holder == id) {
            // Its light first, before any disk is asked.
            self.send_urgent(Urgent::Abort);
        }
        if is_opening {
            return Ok(Step::Unwritten(id, order));
        }
        if comes_next {
            return Ok(Step::Next(id));
        }
        if self.shutting_down {
            return Err(CommandError::new(503, "the daemon is ending; end the job when it runs again"));
        }
        self.waiting(id)?;
        Ok(Step::Change(id, Change::End(order)))
    }

    /// Answers the orders that engines carry out and that are on disk now, or never will be.
    pub(super) fn answer_written(&mut self) {
        let now_us = self.clock.now_us();
        for order in std::mem::take(&mut self.unwritten) {
            let id = order.job;
            let is_late = order.until_us <= now_us;
            let running = self.running.as_ref().filter(|running| running.job == id).map(|running| &running.engine);
            let warning = match running {
                // One that is ending already may end as a job that can go on.
                Some(engine) if engine.order_unwritten() || engine.is_over() => is_late.then_some(SLOW),
                Some(engine) => {
                    let warning = engine.journal_failed().then_some(UNWRITTEN);
                    self.answer(order, warning);
                    continue;
                }
                None if self.opening == Some(id) => is_late.then_some(SLOW),
                // It came when the job was ending already, as one that could go on.
                None if self
                    .jobs
                    .get(id)
                    .is_some_and(|job| job.view.state == JobState::Interrupted && !job.ordered) =>
                {
                    self.change(id, Change::End(order.order), order.reply);
                    continue;
                }
                None => {
                    self.answer(order, None);
                    continue;
                }
            };
            match warning {
                Some(warning) => self.answer(order, Some(warning)),
                None => self.unwritten.push(order),
            }
        }
    }

    /// Answers the orders for a job that is over and whose journal could not be written.
    pub(super) fn answer_unwritten(&mut self, id: u32) {
        for order in self.unwritten.extract_if(.., |order| order.job == id).collect::<Vec<_>>() {
            self.answer(order, Some(UNWRITTEN));
        }
    }

    fn answer(&mut self, order: Unwritten, warning: Option<&str>) {
        if let Some(warning) = warning {
            self.notice(format!("the order to {} job {} {warning}", order.order.verb(), order.job));
        }
        // Before the answer: one who asks again at once must not see how it was before.
        self.publish_job(order.job);
        let answer = self.view(order.job, warning.map(|warning| format!("the order {warning}")));
        // Whoever asked may have gone.
        let _ = order.reply.send(answer);
    }

    /// The orders for a job that could not be opened: taken away to be answered otherwise.
    pub(super) fn take_unwritten(&mut self, id: u32) -> Vec<Reply> {
        self.unwritten.extract_if(.., |order| order.job == id).map(|order| order.reply).collect()
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
        let confirms = self.setting.machine.confirm_plate;
        let job = self.waiting(id)?;
        if let (Some(order), false) = (job.past.ordered, job.view.state.is_final()) {
            return Err(refused(id, &ResumeError::Ordered(order)));
        }
        let (state, awaits_word) = (job.view.state, confirms || job.awaits_plate || !job.told.is_empty());
        match state {
            JobState::Queued if awaits_word => self.plate_is_clear(id),
            JobState::Interrupted => {
                if let (Some((why, _)), Some(layer), ResumeChoice::None) = (&job.doubt, job.view.in_doubt, choice) {
                    return Err(refused(id, &ResumeError::InDoubt { layer, why: why.clone() }));
                }
                job.clear_told();
                Ok(Step::Change(id, Change::Resume(choice)))
            }
            state => Err(wrong_state(id, state, EngineCommand::Resume)),
        }
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
        let changed = self.jobs.get_mut(id).is_some_and(|job| {
            job.past.order(command);
            job.update(&progress)
        });
        if changed {
            self.publish_job(id);
        }
        Ok(true)
    }

    /// Asks or tells the journal of a job that does not hold the machine, in the background.
    pub(super) fn change(&mut self, id: u32, change: Change, reply: Reply) {
        let Some(job) = self.jobs.get_mut(id) else {
            let _ = reply.send(Err(no_such_job(&id.to_string())));
            return;
        };
        job.ordered = true;
        let (journal, background) = (job.directory.journal(), self.background.clone());
        tokio::task::spawn_blocking(move || {
            let result = settle_in_journal(id, &journal, change);
            let _ = background.blocking_send(Background::Changed { job: id, result, reply });
        });
    }

    /// The journal allows the change and says so, or not.
    pub(super) fn changed(&mut self, id: u32, result: Result<Settled, CommandError>, reply: Reply) {
        let mut aborts = Vec::new();
        if let Some(job) = self.jobs.get_mut(id) {
            job.ordered = false;
            aborts = std::mem::take(&mut job.aborts);
            match result.as_ref().map(|settled| &settled.outcome) {
                Ok(Outcome::Ended(state, reason)) => {
                    self.jobs_ended += 1;
                    job.end(*state, Some(reason.clone()));
                    self.jobs.unqueue(id);
                }
                Ok(Outcome::TakenUp(take_up)) => {
                    if let TakeUp::End(command) = take_up {
                        job.past.order(*command);
                    }
                    self.jobs.take_up(id, *take_up);
                }
                Err(_) => {}
            }
        }
        self.publish_job(id);
        if let (Err(error), true) = (&result, reply.is_closed()) {
            self.notice(format!("an order for job {id} could not be carried out: {}", error.message));
        }
        let is_over = matches!(&result, Ok(Settled { outcome: Outcome::Ended(..), .. }));
        let _ = reply.send(result.and_then(|settled| self.view(id, settled.warning)));
        for abort in aborts {
            if is_over {
                let _ = abort.send(self.view(id, None));
            } else {
                // The first writes it; those behind it come again as they came now.
                match self.jobs.get_mut(id) {
                    Some(job) if job.ordered => job.aborts.push(abort),
                    _ => self.change(id, Change::End(EndOrder::Abort), abort),
                }
            }
        }
    }

    fn known(&mut self, id: u32) -> Result<&mut Job, CommandError> {
        self.jobs.get_mut(id).ok_or_else(|| no_such_job(&id.to_string()))
    }

    /// A job that no other order is being carried out on.
    pub(super) fn waiting(&mut self, id: u32) -> Result<&mut Job, CommandError> {
        let job = self.known(id)?;
        if job.ordered {
            let text = format!("another order for job {id} is being carried out; look at it and try again");
            return Err(CommandError::new(409, text));
        }
        Ok(job)
    }

    pub(super) fn find(&self, id: &str) -> Result<u32, CommandError> {
        let number = id.parse().ok().filter(|number| self.jobs.get(*number).is_some());
        number.ok_or_else(|| no_such_job(id))
    }

    /// A job as an order's answer, with what went wrong although it is carried out.
    pub(super) fn view(&self, id: u32, warning: Option<String>) -> Result<Answer, CommandError> {
        let job = self.jobs.get(id).ok_or_else(|| no_such_job(&id.to_string()))?;
        Ok(JobView { warning, ..job.view.clone() }.into())
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
    use EngineCommand::{Pause, Resume, Stop};
    use JobState::{Aborting, Interrupted, Paused, Queued, Stopping};
    let verb = match command {
        Pause => "pause",
        Resume => "resume",
        Stop => "stop",
        EngineCommand::Abort => "abort",
    };
    let text = match (state, command) {
        (state, Resume) if state.is_final() => format!("job {id} is over ({state}); start the part again instead"),
        (state, _) if state.is_final() => format!("job {id} is over ({state}): there is nothing to {verb}"),
        (Paused, Pause) => format!("job {id} is paused already; `layerctl resume {id}` lets it go on"),
        (Queued, Pause) => {
            format!("job {id} has not begun: there is nothing to pause. `layerctl stop {id}` takes it out of the queue")
        }
        (Queued, Resume) => format!("job {id} begins by itself when its turn comes; it waits for no word"),
        (Interrupted, Pause) => format!("job {id} is interrupted and prints nothing; `resume`, `stop` or `abort` it"),
        (Aborting, Stop) => format!("job {id} is being aborted already, which ends it sooner"),
        (Stopping | Aborting, _) => format!("job {id} is on its way to its end ({state}); it can only be aborted"),
        _ => format!("job {id} is {state}: there is nothing to {verb}"),
    };
    CommandError::new(409, text)
}

/// Why a job is not resumed, with its number.
fn refused(id: u32, error: &ResumeError) -> CommandError {
    CommandError::new(409, error.to_string().replace("JOB", &id.to_string()))
}

/// What is said of an order whose record is not on disk.
const SLOW: &str =
    "is being carried out, but the disk has not taken its record yet: after a crash now it must be given again";
const UNWRITTEN: &str =
    "is carried out, but its record could not be written: after a restart of the daemon it must be given again";

fn no_such_job(id: &str) -> CommandError {
    CommandError::new(404, format!("there is no job `{id}`; `layerctl jobs` lists them"))
}

/// Checks a change against the job's journal and writes there what must be known after a crash. An order to end is carried out
/// whether or not that can be written. Blocks.
fn settle_in_journal(id: u32, path: &Path, change: Change) -> Result<Settled, CommandError> {
    let ended = |state, reason: String| Settled { outcome: Outcome::Ended(state, reason), warning: None };
    let unreadable = |error: JournalError| CommandError::new(500, error.to_string());
    let history = match read_journal(path) {
        Ok((_, history)) => history,
        // The operator must get rid of it; after a restart it comes back for as long as it cannot be read.
        Err(error) if matches!(change, Change::End(EndOrder::Abort) | Change::Close) => {
            let reason = format!("{ENDED}, but {error}: the plate was not lifted; see to plate and light");
            return Ok(ended(JobState::Aborted, reason));
        }
        Err(error) => return Err(unreadable(error)),
    };
    if history.state.is_final() {
        // It could not be read when the daemon started.
        return Ok(ended(history.state, history.reason));
    }
    let write = |record| Journal::open(path).and_then(|(mut journal, _)| journal.append(record, unix_ms()));
    let warning =
        |written: Result<(), JournalError>| written.err().map(|error| format!("the order {UNWRITTEN} ({error})"));
    let (order, reason) = match change {
        Change::Resume(choice) => {
            history.start(choice).map_err(|error| refused(id, &error))?;
            return Ok(Settled { outcome: Outcome::TakenUp(TakeUp::Print(choice)), warning: None });
        }
        Change::End(order) if history.state != JobState::Queued => {
            let warning = warning(if history.ordered == Some(order) { Ok(()) } else { write(Record::Ordered(order)) });
            return Ok(Settled { outcome: Outcome::TakenUp(TakeUp::End(order.into())), warning });
        }
        Change::End(order) => (order, unbegun(order)),
        Change::Close => (EndOrder::Abort, CLOSED),
    };
    let state = if order == EndOrder::Abort { JobState::Aborted } else { JobState::Stopped };
    let warning = warning(write(Record::Ended { state, reason: reason.into() }));
    Ok(Settled { outcome: Outcome::Ended(state, reason.into()), warning })
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
        part.check_footing(&recipe, limit_bytes).map_err(|problem| unprintable(submission, &problem))?;
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
    let (directory, journal) = spool.create(job).map_err(|error| spool_error(&error))?;
    if !journal.is_reserved() {
        tracing::warn!(
            job = directory.id,
            "the spool's file system sets no room aside (fallocate): a full disk can keep the job's end from being written"
        );
    }
    Ok(Job::accepted(directory, key, layer_count, submission.name.clone(), recipe.name))
}

fn spool_error(error: &SpoolError) -> CommandError {
    let is_full = match error {
        SpoolError::NoSpace { .. } => true,
        SpoolError::Io { source, .. } | SpoolError::Journal(JournalError::Io { source, .. }) => {
            source.kind() == std::io::ErrorKind::StorageFull
        }
        _ => false,
    };
    let status = if is_full { 507 } else { 500 };
    CommandError::new(status, error.to_string())
}
