//! Orders for a job that does not hold the machine: its journal is asked, and told, before anything else.

use std::path::Path;

use super::background::{Background, Reply};
use super::clock::unix_ms;
use super::handle::CommandError;
use super::job::TakeUp;
use super::orders::{no_such_job, refused};
use super::past::Past;
use super::printer::Printer;
use super::unwritten::UNWRITTEN;
use crate::job::{EndOrder, JobState, Journal, JournalError, PlateAfter, Record, ResumeChoice, read_journal};

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

/// Why a job ended that had not begun.
fn unbegun(order: EndOrder) -> &'static str {
    match order {
        EndOrder::Abort => "aborted by the operator before it began",
        EndOrder::Stop => "stopped by the operator before it began",
    }
}

const ENDED: &str = "ended by the operator";

impl Printer {
    /// Asks or tells the journal of a job that does not hold the machine, in the background.
    pub(super) fn change(&mut self, id: u32, change: Change, reply: Reply) {
        let Some(job) = self.jobs.get_mut(id) else {
            let _ = reply.send(Err(no_such_job(&id.to_string())));
            return;
        };
        job.ordered = true;
        let (journal, past, background) = (job.directory.journal(), job.past.clone(), self.background.clone());
        tokio::task::spawn_blocking(move || {
            let result = settle_in_journal(id, &journal, &past, change);
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
}

/// Checks a change against the job's journal and writes there what must be known after a crash. An order to end is carried out
/// whether or not that can be written; `past` is what is known without the journal. Blocks.
fn settle_in_journal(id: u32, path: &Path, past: &Past, change: Change) -> Result<Settled, CommandError> {
    let ended = |state, reason: String| Settled { outcome: Outcome::Ended(state, reason), warning: None };
    let unreadable = |error: JournalError| CommandError::new(500, error.to_string());
    let history = match read_journal(path) {
        Ok((_, history)) => history,
        Err(error) => {
            let state = match change {
                Change::End(EndOrder::Abort) | Change::Close => JobState::Aborted,
                // A part in the vat keeps the machine, unless it is aborted.
                Change::End(EndOrder::Stop) if past.plate_after() == PlateAfter::Left => {
                    return Err(CommandError::new(
                        409,
                        format!("{error}; {}. `layerctl abort {id}` ends the job all the same", past.plate_text()),
                    ));
                }
                Change::End(EndOrder::Stop) => JobState::Stopped,
                Change::Resume(_) => return Err(unreadable(error)),
            };
            // The operator must get rid of it; after a restart it comes back for as long as it cannot be read.
            let reason = format!("{ENDED}, but {error}: {}", past.plate_text());
            let warning = Some(format!("the order {UNWRITTEN} ({error})"));
            return Ok(Settled { outcome: Outcome::Ended(state, reason), warning });
        }
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
        Change::End(order) => (order, unbegun(order).to_owned()),
        Change::Close => {
            let plate = Past::from(&history).plate_text();
            (EndOrder::Abort, format!("{ENDED}; the part could not be opened: {plate}"))
        }
    };
    let state = if order == EndOrder::Abort { JobState::Aborted } else { JobState::Stopped };
    let warning = warning(write(Record::Ended { state, reason: reason.clone() }));
    Ok(Settled { outcome: Outcome::Ended(state, reason), warning })
}
