//! Orders at random moments, their answers, and what was promised with them.

use std::fmt::Write as _;
use std::sync::Arc;

use layerd::api::{InDoubt, JobView};
use layerd::daemon::handle::Answer;
use layerd::job::JobState;

use super::{DECIDED, Pause, World};
use crate::operators::{Ask, Decided, Given, asks_for_empty_plate, give, number};
use crate::plan::Wish;

impl World {
    /// An operator at a random moment.
    pub(super) fn wish(&mut self, wish: Wish) {
        let Some(host) = &self.host else { return };
        let jobs: Vec<_> = host.handle.snapshot().jobs.clone();
        let job = |pick: usize| jobs.iter().rev().nth(pick % jobs.len().max(1));
        let of = |pick: usize| job(pick).map(number);
        let ask = match wish {
            Wish::Submit { part } => Some(Ask::Submit { part }),
            Wish::Again { pick } => of(pick).map(Ask::Again),
            Wish::Pause { pick } => of(pick).map(Ask::Pause),
            Wish::Resume { pick } => job(pick).map(|job| Ask::Resume(number(job), self.judge(job))),
            Wish::Stop { pick } => of(pick).map(Ask::Stop),
            Wish::Abort { pick: None } => Some(Ask::Abort(None)),
            Wish::Abort { pick: Some(pick) } => of(pick).map(|id| Ask::Abort(Some(id))),
            Wish::Remove { pick } => of(pick).map(Ask::Remove),
            Wish::Raise => Some(Ask::Raise),
        };
        if let Some(Ask::Stop(id) | Ask::Abort(Some(id))) = ask {
            self.promises.told_to_end.insert(id);
        }
        if ask == Some(Ask::Abort(None)) {
            self.promises.told_to_end.extend(jobs.iter().map(number));
        }
        ask.iter().for_each(|ask| self.give(ask));
    }

    /// What an operator who looks at the part says of a job's layer in doubt.
    pub(super) fn judge(&self, job: &JobView) -> Option<(u32, InDoubt)> {
        let layer = job.in_doubt?;
        let is_exposed = self.printed(number(job)).is_some_and(|printed| printed.whole.contains_key(&layer));
        Some((layer, if is_exposed { InDoubt::Exposed } else { InDoubt::Repeat }))
    }

    pub(super) fn give(&mut self, ask: &Ask) {
        let Some(host) = &self.host else { return };
        let snapshot = host.handle.snapshot().clone();
        let confirms = match ask {
            // A part in the vat is out of sight, and the daemon must ask for it; unless nobody knows where the plate is. What the daemon
            // knows is void if the machine has forgotten it since.
            Ask::Submit { .. } | Ask::Again(_) => {
                let told = snapshot.device.state.as_ref().and_then(|state| state.position_um);
                let station = &self.stations[self.connected];
                told.is_none() || !station.machine.knows_plate() || station.is_clear()
            }
            Ask::Resume(id, _) => {
                let confirms = |job: &&JobView| job.state == JobState::Queued || asks_for_empty_plate(job);
                snapshot.job(&id.to_string()).filter(confirms).is_some()
            }
            _ => false,
        };
        let of = match ask {
            Ask::Resume(id, _) => Some(*id),
            _ => None,
        };
        let holder = snapshot.active().map(number);
        if confirms && (holder.is_none() || holder == of) && self.stations[self.connected].part_um.take().is_some() {
            self.note(|| "operator: takes the part off".into());
        }
        match ask {
            Ask::Remove(id) => *self.promises.going.entry(*id).or_default() += 1,
            Ask::Submit { .. } | Ask::Again(_) => self.promises.unanswered += 1,
            _ => {}
        }
        let decided =
            Decided { kind: self.plan.kind, ask: ask.clone(), given_us: self.now_us, jobs_ended: snapshot.jobs_ended };
        let Some(host) = &self.host else { return };
        host.spawn(give(decided, host.handle.clone(), Arc::clone(&self.answers), Arc::clone(&self.shared)));
        self.note(|| format!("operator: {ask:?}"));
    }

    pub(super) fn answered(&mut self, given: &Given) {
        let Given { ask, given_us, answer } = given;
        self.note(|| {
            let mut text = format!("operator: {ask:?}: ");
            let _ = match answer {
                Ok(Answer::Job(job)) => {
                    write!(text, "job {} is {} {}", job.id, job.state, job.warning.as_deref().unwrap_or(""))
                }
                Ok(answer) => write!(text, "{answer:?}"),
                Err(error) => write!(text, "refused: {error}"),
            };
            text
        });
        if matches!(ask, Ask::Submit { .. } | Ask::Again(_)) {
            self.promises.unanswered = self.promises.unanswered.saturating_sub(1);
        }
        let job = match answer {
            Ok(Answer::Job(job)) => job,
            Ok(Answer::Removed(removed)) => {
                let id = removed.id.parse().unwrap_or(0);
                self.promises.removed.insert(id);
                self.promises.accepted.remove(&id);
                return;
            }
            Ok(Answer::Raise(_)) => {
                let is_vat = !self.plan.kind.is_laser();
                return self
                    .check("plate above part", is_vat, || "the plate of a bed of powder is to be raised".into());
            }
            Err(error) => {
                // A removal that failed halfway is ended by the next start.
                if let Ask::Remove(id) = ask
                    && error.status != 500
                    && let Some(count) = self.promises.going.get_mut(id)
                {
                    // It may have been given in a spool that was moved away since.
                    *count = count.saturating_sub(1);
                }
                if error.message.contains("restart layerd")
                    && let Some(host) = &self.host
                {
                    host.end();
                }
                // Those who gave orders while things went wrong may be answered late.
                let is_patient = self.patient.since_us.is_some_and(|since_us| *given_us >= since_us);
                if let Ask::Resume(id, _) = ask
                    && is_patient
                {
                    *self.patient.refusals.entry(*id).or_default() += 1;
                }
                return;
            }
        };
        let id = number(job);
        if matches!(ask, Ask::Stop(_) | Ask::Abort(_)) && self.reserve_holds && self.disk.harm().lost == 0 {
            let unwritten = job.warning.clone().filter(|warning| warning.contains("could not be written"));
            self.check("orders recorded", unwritten.is_none(), || format!("job {id}: {ask:?}: {unwritten:?}"));
        }
        let over = self.promises.ended.get(&id).copied().filter(|_| matches!(ask, Ask::Resume(..)));
        self.check("orders carried out", over.is_none(), || format!("job {id} was resumed after its {over:?}"));
        if !matches!(ask, Ask::Pause(_)) {
            // Any other order after a pause cancels it.
            self.promises.pauses.remove(&id);
        }
        match ask {
            Ask::Submit { .. } | Ask::Again(_) => {
                self.promises.accepted.insert(id);
                self.learn_jobs();
            }
            Ask::Pause(_) => {
                let pause = Pause { at_us: self.now_us, ..Pause::default() };
                self.promises.pauses.entry(id).or_insert(pause);
            }
            // A job that has all its layers ends as completed: a stop has no effect on it.
            Ask::Stop(_) if job.warning.is_none() && job.layers_done < job.layers_total => {
                self.promises.ended.entry(id).or_insert("stop");
            }
            Ask::Abort(_) => {
                if *ask == Ask::Abort(None) {
                    // The job may have been on its way when the abort was given.
                    self.promises.told_to_end.insert(id);
                }
                if job.warning.is_none() {
                    self.promises.ended.insert(id, "abort");
                }
                let key = self.key_of(id);
                if let Some(printed) = key.and_then(|key| self.truth.printed.get_mut(&key)) {
                    printed.abort_given_us.get_or_insert(*given_us);
                    printed.is_aborted |= job.warning.is_none();
                }
            }
            Ask::Resume(_, Some((layer, choice))) => {
                if self.plan.kind.is_laser() {
                    self.happen(DECIDED);
                }
                let key = self.key_of(id);
                if let Some(printed) = key.and_then(|key| self.truth.printed.get_mut(&key)) {
                    match choice {
                        InDoubt::Exposed => drop(printed.assumed.insert(*layer)),
                        InDoubt::Repeat => {
                            let whole = printed.whole.get(layer).copied().unwrap_or(0);
                            printed.repeats.insert(*layer, whole + 1);
                            if let Some(marks) = printed.marks.get_mut(layer) {
                                marks.is_broken = false;
                            }
                        }
                    }
                }
            }
            _ => {}
        }
    }
}
