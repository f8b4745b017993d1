//! Orders for a job that does not hold the machine: each is checked against the job's journal and written there first.

use std::path::Path;

use super::unwritten::UNWRITTEN;
use super::{no_such_job, refused};
use crate::daemon::handle::CommandError;
use crate::daemon::host::clock::unix_ms;
use crate::daemon::jobs::job::TakeUp;
use crate::daemon::jobs::past::Past;
use crate::daemon::printer::Printer;
use crate::daemon::printer::background::{Background, Reply};
use crate::job::{EndOrder, JobState, Journal, JournalError, PlateAfter, Record, ResumeChoice, read_journal};

/// An order for a job that does not hold the machine.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Change {
    /// Stop or abort it. A job that has begun needs the machine for that.
    End(EndOrder),
    /// Abort it without the machine, because the part cannot be opened.
    Close,
    /// Resume an interrupted job.
    Resume(ResumeChoice),
}

/// A change that was carried out, and a warning if its record could not be written.
#[derive(Debug)]
pub(crate) struct Settled {
    outcome: Outcome,
    warning: Option<String>,
}

/// The job after a change.
#[derive(Debug)]
enum Outcome {
    /// The job is over, for this reason.
    Ended(JobState, String),
    /// It gets the machine as soon as that is free.
    TakenUp(TakeUp),
}

/// Reason of a job that ended before it began.
fn unbegun(order: EndOrder) -> &'static str {
    match order {
        EndOrder::Abort => "aborted by the operator before it began",
        EndOrder::Stop => "stopped by the operator before it began",
    }
}

const ENDED: &str = "ended by the operator";

impl Printer {
    /// Checks a change against the job's journal and writes it there, in the background.
    pub(crate) fn change(&mut self, id: u32, change: Change, reply: Reply) {
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

    /// Carries out a change that the journal allows, and answers the order.
    pub(crate) fn changed(&mut self, id: u32, result: Result<Settled, CommandError>, reply: Reply) {
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
                // The first abort is written; the others wait for it.
                match self.jobs.get_mut(id) {
                    Some(job) if job.ordered => job.aborts.push(abort),
                    _ => self.change(id, Change::End(EndOrder::Abort), abort),
                }
            }
        }
    }
}

/// Checks a change against the job's journal and writes there what must be known after a crash. An order to end is carried out
/// even if it cannot be written. `past` is used if the journal cannot be read. Blocks.
fn settle_in_journal(id: u32, path: &Path, past: &Past, change: Change) -> Result<Settled, CommandError> {
    let ended = |state, reason: String| Settled { outcome: Outcome::Ended(state, reason), warning: None };
    let history = match read_journal(path) {
        Ok((_, history)) => history,
        Err(error) => return settle_unreadable(id, &error, past, change),
    };
    if history.state.is_final() {
        // The journal could not be read when the daemon started, and can be now.
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

/// Settles a change for a job whose journal cannot be read: it cannot be resumed, but the operator must be able to end it.
fn settle_unreadable(id: u32, error: &JournalError, past: &Past, change: Change) -> Result<Settled, CommandError> {
    let state = match change {
        Change::End(EndOrder::Abort) | Change::Close => JobState::Aborted,
        // A job whose part may lie in the vat keeps the machine until it is aborted.
        Change::End(EndOrder::Stop) if past.plate_after() == PlateAfter::Left => {
            let text = format!("{error}; {}. `layerctl abort {id}` ends the job all the same", past.plate_text());
            return Err(CommandError::new(409, text));
        }
        Change::End(EndOrder::Stop) => JobState::Stopped,
        Change::Resume(_) => return Err(CommandError::new(500, error.to_string())),
    };
    // After a restart the job is back, as long as its journal cannot be read.
    let reason = format!("{ENDED}, but {error}: {}", past.plate_text());
    let warning = Some(format!("the order {UNWRITTEN} ({error})"));
    Ok(Settled { outcome: Outcome::Ended(state, reason), warning })
}
