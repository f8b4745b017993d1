//! Operators' orders: which the state allows, and how they are carried out.
//! `tests/orders.rs` and `tests/control_api/orders.rs` test them.

pub(crate) mod again;
pub(crate) mod change;
pub(crate) mod raise;
pub(crate) mod remove;
pub(crate) mod submit;
pub(crate) mod written;

use crate::api::{InDoubt, JobView};
use crate::config::Kind;
use crate::daemon::error::{OrderError, no_such_job, refused};
use crate::daemon::handle::{Answer, Order, Ticket};
use crate::daemon::jobs::job::{Job, TakeUp};
use crate::daemon::jobs::settle::Change;
use crate::daemon::jobs::unwritten::Unwritten;
use crate::daemon::printer::Printer;
use crate::daemon::printer::publish::RESUME_LATER;
use crate::job::{Command, EndOrder, JobState, ResumeChoice, ResumeError};
use crate::link::message::Urgent;

/// What is left to do for an order before it is answered.
pub(crate) enum Step {
    /// Nothing; the job's view is the answer.
    Done(u32),
    /// The engine carries it out; its record must reach the disk.
    Unwritten(u32, EndOrder),
    /// Another order for the job is being written; this one is next.
    Next(u32),
    /// It must be checked against the job's journal and written there.
    Change(u32, Change),
}

impl Printer {
    /// Carries an order out and answers it.
    pub(crate) fn order(&mut self, ticket: Ticket) {
        let Ticket { order, reply } = ticket;
        if self.shutting_down
            && matches!(order, Order::Submit(_) | Order::Again(_) | Order::Resume { .. } | Order::Remove(_))
        {
            let text = match order {
                Order::Resume { .. } => RESUME_LATER,
                _ => "the daemon is shutting down and begins nothing new",
            };
            let _ = reply.send(Err(OrderError::new(503, text)));
            if let Order::Submit(submission) = order {
                submission.discard();
            }
            return;
        }
        let step = match order {
            Order::Submit(submission) => return self.submit(submission, reply),
            Order::Again(again) => return self.print_again(again, reply),
            Order::Remove(id) => return self.remove(&id, reply),
            Order::Raise => return self.raise(reply),
            Order::Pause(id) => self.steer(&id, Command::Pause),
            Order::Stop(id) => self.steer(&id, Command::Stop),
            Order::Resume { id, in_doubt, jobs_ended } => self.resume(&id, in_doubt, jobs_ended),
            Order::Abort(Some(id)) => self.steer(&id, Command::Abort),
            Order::Abort(None) => self.abort_active(),
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
                let unwritten = Unwritten::new(job, order, reply, self.clock.now_us());
                return self.unwritten.push(unwritten);
            }
            Ok(Step::Done(id)) => {
                // Before the answer: a client that asks again at once must not see the old state.
                self.publish_job(id);
                self.view(id, None)
            }
            Err(error) => Err(error),
        };
        // The client may be gone.
        let _ = reply.send(answer);
    }

    /// Aborts the job that holds the machine; without one the device is told to go dark.
    fn abort_active(&mut self) -> Result<Step, OrderError> {
        if let Some(id) = self.holder().or_else(|| self.jobs.interrupted()).or_else(|| self.jobs.ending()) {
            return self.steer(&id.to_string(), Command::Abort);
        }
        // There may be light even without a job.
        self.send_urgent(Urgent::Abort);
        let text = if self.device.connected {
            "no job is active, so there is nothing to abort; the device is told to go dark at once all the same: `layerctl device` \
             shows its light"
        } else {
            "no job is active, so there is nothing to abort; the device is told to go dark all the same, as soon as it answers"
        };
        Err(OrderError::new(409, text))
    }

    /// Pause, stop or abort.
    fn steer(&mut self, id: &str, command: Command) -> Result<Step, OrderError> {
        let id = self.find(id)?;
        let end = match command {
            Command::Abort => Some(EndOrder::Abort),
            Command::Stop => Some(EndOrder::Stop),
            Command::Pause | Command::Resume => None,
        };
        if self.command_running(id, command)? {
            return Ok(end.map_or(Step::Done(id), |order| Step::Unwritten(id, order)));
        }
        let (is_opening, holder) = (self.opening == Some(id), self.holder());
        let job = self.known(id)?;
        let state = job.view.state;
        if is_opening && job.is_to_print() && command == Command::Pause {
            // Its engine gets the order first of all.
            job.pauses = true;
            return Ok(Step::Done(id));
        }
        let ends = match command {
            Command::Abort => !state.is_final(),
            Command::Stop => !state.is_final() && state != JobState::Aborting,
            Command::Pause | Command::Resume => false,
        };
        let Some(order) = end.filter(|_| ends) else { return Err(wrong_state(id, state, command)) };
        if is_opening {
            job.take_up = TakeUp::End(command);
            job.view.state = job.take_up.state_before(state);
        }
        let is_abort = order == EndOrder::Abort;
        let (comes_next, has_begun) = (is_abort && job.ordered, job.has_begun());
        if is_abort && has_begun && holder.is_none_or(|holder| holder == id) {
            // The light goes off first, before any disk access.
            self.send_urgent(Urgent::Abort);
        }
        if is_opening {
            return Ok(Step::Unwritten(id, order));
        }
        if comes_next {
            return Ok(Step::Next(id));
        }
        if self.shutting_down {
            return Err(OrderError::new(503, "the daemon is shutting down; end the job when it runs again"));
        }
        self.waiting(id)?;
        Ok(Step::Change(id, Change::End(order)))
    }

    fn resume(&mut self, id: &str, in_doubt: Option<InDoubt>, jobs_ended: u64) -> Result<Step, OrderError> {
        let id = self.find(id)?;
        if in_doubt.is_some() {
            self.check_doubt(id)?;
        }
        if self.command_running(id, Command::Resume)? {
            return Ok(Step::Done(id));
        }
        let stays = self.cannot_go_on(id);
        let is_unfit = self.jobs.get(id).is_some_and(|job| self.awaits_other_device(job).is_some());
        let choice = match in_doubt {
            None => ResumeChoice::None,
            Some(InDoubt::Exposed) => ResumeChoice::AssumeExposed,
            Some(InDoubt::Repeat) => ResumeChoice::Repeat,
        };
        let confirms = self.setting.machine.confirm_plate();
        let job = self.waiting(id)?;
        if let (Some(order), false) = (job.past.ordered, job.view.state.is_final()) {
            return Err(refused(id, &ResumeError::Ordered(order)));
        }
        let (state, needs_confirmation) = (job.view.state, confirms || job.awaits_plate || !job.told.is_empty());
        match state {
            JobState::Queued if needs_confirmation || is_unfit => self.plate_is_clear(id, jobs_ended),
            JobState::Interrupted => {
                if let Some(text) = stays {
                    return Err(OrderError::new(409, text));
                }
                if let (Some((why, _)), Some(open), ResumeChoice::None) = (&job.doubt, job.past.unconfirmed, choice) {
                    let [exposure, next] = [0, 1].map(|on| job.past.passes.text(open.exposure + on));
                    return Err(refused(id, &ResumeError::InDoubt { exposure, next, why: why.clone() }));
                }
                job.clear_told();
                Ok(Step::Change(id, Change::Resume(choice)))
            }
            state => Err(wrong_state(id, state, Command::Resume)),
        }
    }

    /// Takes the operator's confirmation for a queued job that the plate is empty. Refused until the job is next: before that the
    /// operator cannot have looked at the plate that the job will find. It is also refused if a job has ended since the request
    /// arrived.
    fn plate_is_clear(&mut self, id: u32, jobs_ended: u64) -> Result<Step, OrderError> {
        if jobs_ended != self.jobs_ended {
            let text = format!(
                "a job ended while this order arrived, so its part may be on the plate: look, then give `layerctl resume {id}` again"
            );
            return Err(OrderError::new(409, text));
        }
        if let Some(ahead) = self.jobs.ahead_of(id, self.holder()) {
            let text = format!("job {id} {ahead}; what is on the plate then is not known yet");
            return Err(OrderError::new(409, text));
        }
        if let Some(misfit) = self.jobs.get(id).and_then(|job| self.misfit_of(job)) {
            let text =
                format!("job {id} waits for a device that fits, and the plate is not taken to be empty yet: {misfit}");
            return Err(OrderError::new(409, text));
        }
        let job = self.waiting(id)?;
        job.awaits_plate = false;
        job.pauses = false;
        job.clear_told();
        self.set_raised(None);
        self.publish_job(id);
        Ok(Step::Done(id))
    }

    /// Why an interrupted job cannot go on with the device that is connected; `None` if it can, or if that is not known yet.
    fn cannot_go_on(&self, id: u32) -> Option<String> {
        let job = self.jobs.get(id).filter(|job| job.view.state == JobState::Interrupted)?;
        if let Some(misfit) = self.misfit_of(job) {
            return Some(format!("job {id} cannot go on with this device: {misfit}"));
        }
        let is_lost = self.device_state.as_ref().is_some_and(|state| state.position_um.is_none() && !state.moving);
        (is_lost && job.past.touched).then(|| {
            let danger = match self.setting.machine.kind() {
                Kind::Dlp => "drive the part into the vat's bottom",
                Kind::Slm => "raise the part into the recoater's way",
            };
            format!(
                "job {id} cannot be resumed: the device does not know where its plate is, and homing would {danger}. \
                 `layerctl abort {id}`, take the part off, and start it again"
            )
        })
    }

    /// Refuses a decision on a layer in doubt if it is known that no layer of the job is.
    fn check_doubt(&self, id: u32) -> Result<(), OrderError> {
        let Some(job) = self.jobs.get(id).filter(|job| !job.view.state.is_final()) else { return Ok(()) };
        // While there is light, or without a device, it is not known yet how the exposure ends.
        let is_settled = self.device_state.as_ref().is_some_and(|state| !state.light_on && state.exposing.is_none());
        let may_be = job.view.in_doubt.is_some() || (job.past.unconfirmed.is_some() && !is_settled);
        if may_be && job.view.state == JobState::Interrupted {
            return Ok(());
        }
        Err(OrderError::new(409, format!("no layer of job {id} is in doubt: resume it without --in-doubt")))
    }

    /// Gives the order to the engine if the job is running; returns whether it is.
    fn command_running(&mut self, id: u32, command: Command) -> Result<bool, OrderError> {
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

    fn known(&mut self, id: u32) -> Result<&mut Job, OrderError> {
        self.jobs.get_mut(id).ok_or_else(|| no_such_job(&id.to_string()))
    }

    /// A job for which no other order is being carried out.
    pub(crate) fn waiting(&mut self, id: u32) -> Result<&mut Job, OrderError> {
        let job = self.known(id)?;
        if job.ordered {
            let text = format!("another order for job {id} is being carried out; look at it and try again");
            return Err(OrderError::new(409, text));
        }
        Ok(job)
    }

    pub(crate) fn find(&self, id: &str) -> Result<u32, OrderError> {
        let number = id.parse().ok().filter(|number| self.jobs.get(*number).is_some());
        number.ok_or_else(|| no_such_job(id))
    }

    /// The answer to an order: the job, with a warning.
    pub(crate) fn view(&self, id: u32, warning: Option<String>) -> Result<Answer, OrderError> {
        let job = self.jobs.get(id).ok_or_else(|| no_such_job(&id.to_string()))?;
        Ok(JobView { warning, ..self.shown(job.view.clone()) }.into())
    }
}

/// Whether a running job in `state` takes the command.
fn allowed(state: JobState, command: Command) -> bool {
    use JobState::{Aborting, Checking, Paused, Pausing, Printing, Stopping};
    match command {
        Command::Pause => matches!(state, Checking | Printing | Pausing),
        Command::Resume => matches!(state, Pausing | Paused),
        Command::Stop => matches!(state, Checking | Printing | Pausing | Paused | Stopping),
        Command::Abort => matches!(state, Checking | Printing | Pausing | Paused | Stopping | Aborting),
    }
}

fn wrong_state(id: u32, state: JobState, command: Command) -> OrderError {
    use Command::{Pause, Resume, Stop};
    use JobState::{Aborting, Interrupted, Paused, Queued, Stopping};
    let verb = match command {
        Pause => "pause",
        Resume => "resume",
        Stop => "stop",
        Command::Abort => "abort",
    };
    let text = match (state, command) {
        (state, Resume) if state.is_final() => {
            format!("job {id} is over ({state}); start the part again instead: `layerctl start --again {id}`")
        }
        (state, _) if state.is_final() => format!("job {id} is over ({state}): there is nothing to {verb}"),
        (Paused, Pause) => format!("job {id} is paused already; `layerctl resume {id}` lets it go on"),
        (Queued, Pause) => {
            format!("job {id} has not begun: there is nothing to pause. `layerctl stop {id}` takes it out of the queue")
        }
        (Queued, Resume) => format!("job {id} begins by itself when its turn comes; it needs no confirmation"),
        (Interrupted, Pause) => format!("job {id} is interrupted and prints nothing; `resume`, `stop` or `abort` it"),
        (Aborting, Stop) => format!("job {id} is being aborted already, which ends it sooner"),
        (Stopping | Aborting, _) => format!("job {id} is on its way to its end ({state}); it can only be aborted"),
        _ => format!("job {id} is {state}: there is nothing to {verb}"),
    };
    OrderError::new(409, text)
}
