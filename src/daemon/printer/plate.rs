//! Signs of an earlier part on the plate or in the vat, and the operator's confirmation that it is gone.
//!
//! A job that has had no light yet drives the plate down: at its first approach, or while homing. Before that, each sign of an
//! earlier part that device or spool shows must be accounted for: by a record that the plate was lifted, or by the operator, who
//! is told each sign and confirms with `layerctl resume JOB`. A part whose plate was lifted is taken off by the operator, before
//! they start the next job or before they confirm one that waited in the queue.

use super::Printer;
use crate::config::Kind;
use crate::daemon::background::Background;
use crate::daemon::jobs::Account;
use crate::daemon::jobs::job::{Job, TakeUp};
use crate::daemon::jobs::sign::{CLEAR_TOLERANCE_UM, LEVEL_TOLERANCE_UM, Seen, Sign, text, traces};
use crate::daemon::machine::idle::Idle;
use crate::job::{Event, Trace};
use crate::link::message::DeviceState;

impl Printer {
    /// The signs that the operator must still confirm before this job, which has had no light, may move the plate down. `state` is
    /// the device's latest in this session.
    pub(crate) fn unknown_signs(&self, job: &Job, state: Option<&DeviceState>) -> Vec<Sign> {
        let mut signs: Vec<_> = self.jobs.left().map(|(job, key)| Sign::Left { job, key }).into_iter().collect();
        if let Some(state) = state {
            let unaccounted = |(trace, seen): (Trace, Seen)| match self.jobs.account(trace, job.directory.id) {
                Account::Known => None,
                Account::NotOf(job) => Some(Sign::Exposure { trace, seen, job: Some(job) }),
                Account::Foreign => Some(Sign::Exposure { trace, seen, job: None }),
            };
            signs.extend(traces(state).into_iter().filter_map(unaccounted));
            signs.extend(self.low_plate(state));
            signs.extend(other_device(job, state));
        }
        signs.extend(self.raised.height_um().map(|from_um| Sign::Raised { from_um }));
        signs.retain(|sign| !sign.is_known(&job.cleared, state));
        signs
    }

    /// The sign that the plate is where a part may be: not clear of the resin, or deep in the powder.
    pub(crate) fn low_plate(&self, state: &DeviceState) -> Option<Sign> {
        let (position_um, boot_id) = (state.position_um?, state.boot_id);
        if self.jobs.bare_on() == Some(boot_id) {
            return None;
        }
        match self.setting.machine.kind() {
            Kind::Dlp => {
                let clear_um = self.clear_um();
                let is_low = position_um < clear_um - CLEAR_TOLERANCE_UM;
                is_low.then_some(Sign::Low { position_um, clear_um, boot_id })
            }
            Kind::Slm => (position_um > LEVEL_TOLERANCE_UM).then_some(Sign::Deep { position_um, boot_id }),
        }
    }

    /// The height at which the plate is clear of the resin, or the device's highest if that is lower, micrometres.
    pub(crate) fn clear_um(&self) -> i32 {
        // `as` saturates; the configuration allows two metres.
        let clear_um = self.setting.machine.clear_height_um().ceil() as i32;
        let highest_um = self.capabilities.as_ref().map(|capabilities| capabilities.machine.max_position_um());
        clear_um.min(highest_um.unwrap_or(clear_um))
    }

    /// Updates what each queued job waits for; returns the jobs where that changed.
    pub(crate) fn explain_queue(&mut self) -> Vec<u32> {
        // While a job runs, it is unknown what the next one will find.
        let next = self.jobs.next().filter(|job| job.needs_bare_plate() && self.holder().is_none());
        let told = next.map(|job| (job.directory.id, self.unknown_signs(job, self.device_state.as_ref())));
        if let Some((id, signs)) = told
            && let Some(job) = self.jobs.get_mut(id)
        {
            job.tell(signs);
        }
        let misfit = self.jobs.next().and_then(|job| self.awaits_other_device(job));
        let light = self.unwanted_light();
        self.jobs.explain(self.holder(), light, misfit.as_deref())
    }

    /// Whether the running job may use a new session. A job that has not begun waits in the queue for a device that fits. A job
    /// that has had no light may move the plate down only if no sign of an earlier part is left unconfirmed on this device.
    pub(crate) fn plate_allows(&mut self, state: &DeviceState, now_us: u64) -> bool {
        let unbegun = self.running.as_ref().filter(|running| !running.engine.has_begun()).map(|running| running.job);
        if let Some(misfit) = unbegun.and_then(|id| self.jobs.get(id)).and_then(|job| self.awaits_other_device(job))
            && let Some(id) = unbegun
        {
            tracing::warn!("job {id} waits for a device that fits: {misfit}");
            self.put_back(id);
            return false;
        }
        let Some(running) = self.running.as_ref().filter(|running| running.engine.goes_down_bare()) else {
            return true;
        };
        let id = running.job;
        let Some(job) = self.jobs.get(id) else { return true };
        let signs = self.unknown_signs(job, Some(state));
        if signs.is_empty() {
            self.note_clear_plate(id, state, now_us);
            return true;
        }
        tracing::warn!(job = id, "{}", text(&signs, id));
        if let Some(job) = self.jobs.get_mut(id) {
            job.tell(signs.clone());
        }
        match &mut self.running {
            Some(running) if running.engine.has_begun() => {
                running.engine.handle(Event::PlateUnclear(text(&signs, id)), now_us);
            }
            _ => self.put_back(id),
        }
        false
    }

    /// Records in the journal, before the first move, that the plate was bare, and the exposures that the operator has confirmed.
    fn note_clear_plate(&mut self, id: u32, state: &DeviceState, now_us: u64) {
        // Accounted for only by the operator's confirmation.
        let is_told = |trace: &Trace| self.jobs.account(*trace, id) != Account::Known;
        let mut traces: Vec<_> = traces(state).into_iter().map(|(trace, _)| trace).filter(is_told).collect();
        traces.dedup();
        let Some(job) = self.jobs.get_mut(id) else { return };
        if job.past.plate_clear_on == Some(state.boot_id) && traces.is_empty() {
            return;
        }
        job.past.plate_clear_on = Some(state.boot_id);
        job.past.traces.extend(&traces);
        let boot_id = state.boot_id;
        self.with_engine(|running| running.engine.handle(Event::PlateClear { boot_id, traces }, now_us));
    }

    /// Takes the machine from a job that has not begun; it waits in the queue for the operator's confirmation.
    fn put_back(&mut self, id: u32) {
        let Some(running) = self.running.take() else { return };
        self.forget_progress();
        if let Some(TakeUp::Print(choice)) = self.jobs.get(id).map(|job| job.take_up) {
            self.jobs.take_up(id, TakeUp::Print(choice));
        }
        if let Some(job) = self.jobs.get_mut(id) {
            job.pauses = running.engine.is_to_pause();
        }
        self.idle = Idle::after(running.engine.light().clone());
        self.releasing = true;
        let background = self.background.clone();
        tokio::spawn(async move {
            running.release().await;
            let _ = background.send(Background::Released { forgotten: Ok(Vec::new()) }).await;
        });
        self.publish_job(id);
    }
}

/// For a job that has had no light an empty plate was found. If the device was exchanged or restarted since then, the plate of the one
/// that is connected now may carry what its last job left.
fn other_device(job: &Job, state: &DeviceState) -> Option<Sign> {
    let boot_id = state.boot_id;
    let has_printed_another = state.last_exposed.is_some_and(|id| id.job != job.key);
    let is_other = job.past.plate_clear_on.is_some_and(|clear_on| clear_on != boot_id);
    (is_other && has_printed_another).then_some(Sign::OtherDevice { boot_id })
}
