//! Orders for a job that does not hold the machine: each is checked against the job's journal and written there first.
//! `tests/orders.rs` shows that they outlive the daemon.

use std::path::Path;

use super::job::{TakeUp, record_dropped};
use super::past::Past;
use crate::daemon::error::{OrderError, refused};
use crate::job::{EndOrder, JobState, Journal, JournalError, PlateAfter, Record, ResumeChoice, read_journal};
use crate::system::unix_ms;

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
    /// The job after it.
    pub outcome: Outcome,
    /// Why it may have to be given again.
    pub warning: Option<String>,
}

/// The job after a change.
#[derive(Debug)]
pub(crate) enum Outcome {
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

/// Warning in the answer to an order whose record could not be written.
pub(crate) const UNWRITTEN: &str =
    "is carried out, but its record could not be written: after a restart of the daemon it must be given again";

const ENDED: &str = "ended by the operator";

/// Checks a change against the job's journal and writes there what must be known after a crash. An order to end is carried out
/// even if it cannot be written. `past` is used if the journal cannot be read. Blocks.
pub(crate) fn settle_in_journal(id: u32, path: &Path, past: &Past, change: Change) -> Result<Settled, OrderError> {
    let ended = |state, reason: String| Settled { outcome: Outcome::Ended(state, reason), warning: None };
    let history = match read_journal(path) {
        Ok((_, history)) => history,
        Err(error) => return settle_unreadable(id, &error, past, change),
    };
    if past.unknown && matches!(change, Change::Resume(_)) {
        // The printer must take in first what the journal says: whether the job is over, and what may be on the plate.
        let text = format!("the journal of job {id} could not be read until now: look at the job, then try again");
        return Err(OrderError::new(409, text));
    }
    if history.state.is_final() {
        // The journal could not be read when the daemon started, and can be now.
        return Ok(ended(history.state, history.reason));
    }
    let write = |record| {
        let (mut journal, history) = Journal::open(path)?;
        record_dropped(id, &mut journal, &history);
        journal.append(record, unix_ms())
    };
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
fn settle_unreadable(id: u32, error: &JournalError, past: &Past, change: Change) -> Result<Settled, OrderError> {
    let state = match change {
        Change::End(EndOrder::Abort) | Change::Close => JobState::Aborted,
        // A job whose part may lie in the vat keeps the machine until it is aborted.
        Change::End(EndOrder::Stop) if past.plate_after() == PlateAfter::Left => {
            let text = format!("{error}; {}. `layerctl abort {id}` ends the job all the same", past.plate_text());
            return Err(OrderError::new(409, text));
        }
        Change::End(EndOrder::Stop) => JobState::Stopped,
        Change::Resume(_) => return Err(OrderError::new(500, error.to_string())),
    };
    // After a restart the job is back, as long as its journal cannot be read.
    let reason = format!("{ENDED}, but {error}: {}", past.plate_text());
    let warning = Some(format!("the order {UNWRITTEN} ({error})"));
    Ok(Settled { outcome: Outcome::Ended(state, reason), warning })
}
