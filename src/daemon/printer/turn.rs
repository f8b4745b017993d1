//! A job's turn: it is opened, gets the machine, and gives it back. `tests/plate.rs` and `tests/print.rs` show turns.

use std::sync::{Arc, PoisonError};

use super::Printer;
use crate::daemon::background::Background;
use crate::daemon::error::OrderError;
use crate::daemon::jobs::job::TakeUp;
use crate::daemon::jobs::opened::{Opened, Unopened};
use crate::daemon::jobs::settle::Change;
use crate::daemon::machine::idle::Idle;
use crate::daemon::machine::running::Running;
use crate::job::{Command, Event, JobState};
use crate::system::spawn_blocking;

impl Printer {
    /// Opens the next job in the background, if it may begin now.
    pub(crate) fn open_next(&mut self) {
        let Some(job) = self.jobs.next() else { return };
        let needs_confirmation = || {
            let signs = || self.unknown_signs(job, self.device_state.as_ref());
            job.needs_bare_plate() && !(job.told.is_empty() && signs().is_empty())
        };
        if job.is_to_print() && self.unwanted_light().is_some() || self.awaits_other_device(job).is_some() {
            return;
        }
        if job.awaits_plate || (job.awaits_device && !self.device.connected) || needs_confirmation() {
            return;
        }
        let id = job.directory.id;
        self.jobs.take(id, self.setting.machine.confirm_plate());
        let Some(job) = self.jobs.get_mut(id) else { return };
        let (directory, take_up, has_begun) = (job.directory.clone(), job.take_up, job.has_begun());
        job.view.state = take_up.state_before(JobState::Checking);
        job.view.reason = None;
        let (threads, limit_bytes) = (self.setting.threads, self.budget.limit_bytes());
        let background = self.background.clone();
        self.opening = Some(id);
        self.publish_job(id);
        spawn_blocking(move || {
            let result = Opened::open(&directory, take_up, has_begun, threads, limit_bytes).map(Box::new);
            let _ = background.blocking_send(Background::Opened { job: id, result });
        });
    }

    /// Handles a job that was opened, or could not be.
    pub(crate) fn opened(&mut self, id: u32, result: Result<Box<Opened>, Unopened>, now_us: u64) {
        self.opening = None;
        // An order may have come while the job was opened.
        let order = self.jobs.get_mut(id).and_then(|job| {
            let pauses = std::mem::take(&mut job.pauses);
            match job.take_up {
                TakeUp::Print(_) => pauses.then_some(Command::Pause),
                TakeUp::End(command) => Some(command),
            }
        });
        match result {
            Ok(opened) => self.begin(id, *opened, order, now_us),
            Err(unopened) => self.refuse_unopened(id, unopened, order),
        }
    }

    /// Gives an opened job the machine.
    fn begin(&mut self, id: u32, mut opened: Opened, order: Option<Command>, now_us: u64) {
        tracing::info!(job = id, "job begins");
        // The present value, not the one stored with the job: correcting it lets an interrupted job go on.
        opened.machine.set_time_scale(self.setting.machine.time_scale());
        let (light, key) = (std::mem::take(&mut self.idle).light, opened.key);
        let mut running = Running::new(id, opened, light, self.background.clone(), now_us);
        if let Some(command) = order {
            running.command(command, now_us);
        }
        if self.shutting_down {
            running.engine.handle(Event::Shutdown, now_us);
        }
        if let Some(job) = self.jobs.get_mut(id) {
            // Its journal may not have been readable before.
            job.key = key;
        }
        self.message = None;
        self.running = Some(running);
        // A new session reports the device's state and numbers requests from 1, as the job's driver expects.
        self.link.reconnect();
    }

    /// Ends a job that could not be opened, and answers the orders for it.
    fn refuse_unopened(&mut self, id: u32, unopened: Unopened, order: Option<Command>) {
        let Unopened { text, state, is_recorded } = unopened;
        self.notice(format!("job {id} cannot be printed: {text}"));
        if let Some(job) = self.jobs.get_mut(id) {
            job.end(state, Some(text.clone()));
            job.end_unwritten = !is_recorded;
        }
        self.jobs_ended += 1;
        self.publish_job(id);
        let mut replies = self.take_unwritten(id);
        if let (Some(Command::Abort), JobState::Interrupted) = (order, state) {
            let reply = replies.pop().unwrap_or_else(|| tokio::sync::oneshot::channel().0);
            self.change(id, Change::Close, reply);
        }
        for reply in replies {
            let failed = || OrderError::new(409, format!("job {id} could not be taken up: {text}"));
            // The client may be gone.
            let _ = reply.send(if state.is_final() { self.ended_view(id) } else { Err(failed()) });
        }
    }

    /// Ends the running job. Its memory is given back, and the spool's oldest jobs are deleted, in the background.
    pub(crate) fn finish(&mut self) {
        self.tell_progress();
        let Some(running) = self.running.take() else { return };
        self.forget_progress();
        let id = running.job;
        let mut again = None;
        if let Some(job) = self.jobs.get_mut(id) {
            job.past.update(&running.engine);
            job.end_unwritten = running.engine.journal_failed();
            // The order to end could not be carried out because the device was gone; it is carried out when it answers again.
            again = job.past.ordered.filter(|_| job.view.state == JobState::Interrupted && !self.device.connected);
        }
        self.jobs_ended += 1;
        // It is from before the job's last moves.
        self.device_state = None;
        if let Some(job) = self.jobs.get(id) {
            job.log_end();
        }
        // A plate that was raised while this job was interrupted carried this job's part, and its record says that it was lifted.
        if self.jobs.get(id).is_some_and(|job| job.view.state.is_final() && job.past.touched && job.past.lifted) {
            self.set_raised(None);
        }
        if let Some(order) = again {
            self.jobs.end_later(id, order);
        }
        self.idle = Idle::after(running.engine.light().clone());
        self.link.reconnect();
        self.releasing = true;
        let (spool, over, background) = (Arc::clone(&self.spool), self.jobs.over(), self.background.clone());
        tokio::spawn(async move {
            running.release().await;
            let tidy = move || spool.lock().unwrap_or_else(PoisonError::into_inner).tidy(&over);
            let forgotten = match spawn_blocking(tidy).await {
                Ok(tidied) => tidied.map_err(|error| error.to_string()),
                Err(panic) => Err(panic.to_string()),
            };
            let _ = background.send(Background::Released { forgotten }).await;
        });
        self.publish();
    }

    /// Forgets the message and the progress of a job that no longer runs.
    pub(crate) fn forget_progress(&mut self) {
        self.message = None;
        self.last_progress = None;
    }
}
