//! Orders for a job that does not hold the machine are written to its journal in the background, and then carried out.
//! `tests/orders.rs` tests it on a full disk and over a crash.

use crate::daemon::background::Background;
use crate::daemon::error::{OrderError, no_such_job};
use crate::daemon::handle::Reply;
use crate::daemon::jobs::job::TakeUp;
use crate::daemon::jobs::settle::{Change, Outcome, Settled, settle_in_journal};
use crate::daemon::printer::Printer;
use crate::job::EndOrder;
use crate::system::spawn_blocking;

impl Printer {
    /// Checks a change against the job's journal and writes it there, in the background.
    pub(crate) fn change(&mut self, id: u32, change: Change, reply: Reply) {
        let Some(job) = self.jobs.get_mut(id) else {
            let _ = reply.send(Err(no_such_job(&id.to_string())));
            return;
        };
        job.ordered = true;
        let (journal, past, background) = (job.directory.journal(), job.past.clone(), self.background.clone());
        spawn_blocking(move || {
            let result = settle_in_journal(id, &journal, &past, change);
            let _ = background.blocking_send(Background::Changed { job: id, result, reply });
        });
    }

    /// Carries out a change that the journal allows, and answers the order.
    pub(crate) fn changed(&mut self, id: u32, result: Result<Settled, OrderError>, reply: Reply) {
        let mut aborts = Vec::new();
        if let Some(job) = self.jobs.get_mut(id) {
            job.ordered = false;
            aborts = std::mem::take(&mut job.aborts);
            match result.as_ref().map(|settled| &settled.outcome) {
                Ok(Outcome::Ended(state, reason)) => {
                    self.jobs_ended += 1;
                    job.end(*state, Some(reason.clone()));
                    job.end_unwritten = result.as_ref().is_ok_and(|settled| settled.warning.is_some());
                    self.jobs.unqueue(id);
                }
                Ok(Outcome::TakenUp(take_up)) => {
                    if let TakeUp::End(command) = take_up {
                        job.past.order(*command);
                    }
                    self.jobs.take_up(id, *take_up);
                }
                Err(_) if job.past.unknown => self.unread.hurry(),
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
                let _ = abort.send(self.ended_view(id));
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
