//! Orders that an engine carries out. Each is answered once its record is on disk, so that a crash cannot undo it.
//! `tests/orders.rs` tests it.

use crate::daemon::error::OrderError;
use crate::daemon::handle::{Answer, Reply};
use crate::daemon::jobs::settle::{Change, UNWRITTEN};
use crate::daemon::jobs::unwritten::Unwritten;
use crate::daemon::printer::Printer;

/// Warning in the answer to an order whose record is not on disk yet.
const SLOW: &str =
    "is being carried out, but the disk has not taken its record yet: after a crash now it must be given again";

impl Printer {
    /// Answers the orders whose records are on disk by now, failed to be written, or take too long.
    pub(crate) fn answer_written(&mut self) {
        let now_us = self.clock.now_us();
        for order in std::mem::take(&mut self.unwritten) {
            let id = order.job;
            let is_late = order.until_us <= now_us;
            let running = self.running.as_ref().filter(|running| running.job == id).map(|running| &running.engine);
            let warning = match running {
                // A job that is ending may end as interrupted; then the order must be carried out again.
                Some(engine) if engine.order_unwritten() || engine.is_over() => is_late.then_some(SLOW),
                Some(engine) => {
                    let warning = engine.journal_failed().then_some(UNWRITTEN);
                    self.answer(order, warning);
                    continue;
                }
                None if self.opening == Some(id) => is_late.then_some(SLOW),
                None => match self.jobs.get(id).filter(|job| !job.view.state.is_final()) {
                    // The job was already ending when the order came, and is not over: its journal may have no record of the order.
                    Some(job) if !job.ordered => {
                        self.change(id, Change::End(order.order), order.reply);
                        continue;
                    }
                    Some(_) => is_late.then_some(SLOW),
                    None => {
                        self.answer(order, self.end_warning(id));
                        continue;
                    }
                },
            };
            match warning {
                Some(warning) => self.answer(order, Some(warning)),
                None => self.unwritten.push(order),
            }
        }
    }

    /// Warning in the answer to an order for a job that is over, if the record of its end could not be written.
    fn end_warning(&self, id: u32) -> Option<&'static str> {
        self.jobs.get(id).filter(|job| job.end_unwritten).map(|_| UNWRITTEN)
    }

    /// The answer to an order to end a job that is over.
    pub(crate) fn ended_view(&self, id: u32) -> Result<Answer, OrderError> {
        self.view(id, self.end_warning(id).map(|warning| format!("the order {warning}")))
    }

    fn answer(&mut self, order: Unwritten, warning: Option<&str>) {
        if let Some(warning) = warning {
            self.notice(format!("the order to {} job {} {warning}", order.order.verb(), order.job));
        }
        // Before the answer: a client that asks again at once must not see the old state.
        self.publish_job(order.job);
        let answer = self.view(order.job, warning.map(|warning| format!("the order {warning}")));
        // The client may be gone.
        let _ = order.reply.send(answer);
    }

    /// Removes the orders for a job that could not be opened; the caller answers them.
    pub(crate) fn take_unwritten(&mut self, id: u32) -> Vec<Reply> {
        self.unwritten.extract_if(.., |order| order.job == id).map(|order| order.reply).collect()
    }
}
