//! The jobs the daemon knows, and the queue. `tests/control_api/orders.rs` fills the queue.

pub(crate) mod job;
pub(crate) mod opened;
pub(crate) mod past;
pub(crate) mod resin;
pub(crate) mod settle;
pub(crate) mod sign;
pub(crate) mod unwritten;

use std::collections::{BTreeMap, VecDeque};

use self::job::{Job, TakeUp};
use crate::api::JobView;
use crate::job::{Command, EndOrder, Forgotten, JobDirectory, JobState, MAX_FORGOTTEN, PlateAfter, Trace};
use crate::link::message::ExposureId;

/// What the daemon's records say of a layer that the device shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Account {
    /// A journal has a record of it, or the operator has confirmed it.
    Known,
    /// The key is this job's, but its journal has no record of it.
    NotOf(u32),
    /// No job in this spool has that key.
    Foreign,
}

/// All jobs, and the queue.
#[derive(Debug, Default)]
pub(crate) struct Jobs {
    jobs: BTreeMap<u32, Job>,
    queue: VecDeque<u32>,
    /// What is still known of jobs whose records were deleted.
    forgotten: BTreeMap<u32, Forgotten>,
}

impl Jobs {
    /// Reads the journals of a spool's jobs. Queued jobs stay queued; if `awaits_plate`, each needs a confirmation that the plate
    /// is empty. A job with an order to end from before a crash ends as soon as a device answers.
    pub(crate) fn load(directories: Vec<JobDirectory>, forgotten: Vec<Forgotten>, awaits_plate: bool) -> Self {
        let forgotten = forgotten.into_iter().map(|job| (job.id, job)).collect();
        let mut jobs = Self { forgotten, ..Self::default() };
        for directory in directories {
            jobs.add(Job::load(directory, awaits_plate));
        }
        jobs
    }

    /// Adds a job that was read from the spool, or replaces what was known of it.
    pub(crate) fn add(&mut self, job: Job) {
        let (id, state, ordered) = (job.directory.id, job.view.state, job.past.ordered);
        // A journal that cannot be read is logged when it is opened.
        if state == JobState::Interrupted && !job.past.unknown {
            tracing::warn!("job {id} is interrupted: {}", job.view.reason.as_deref().unwrap_or("no reason is known"));
        }
        self.jobs.insert(id, job);
        match (state, ordered) {
            (JobState::Queued, _) => self.queue.push_back(id),
            (JobState::Interrupted, Some(order)) => self.end_later(id, order),
            _ => {}
        }
    }

    /// The jobs whose journals could not be read, and may become readable.
    pub(crate) fn unread(&self) -> impl Iterator<Item = &JobDirectory> {
        self.jobs.values().filter(|job| job.is_unread()).map(|job| &job.directory)
    }

    /// Adds a new job at the end of the queue.
    pub(crate) fn accept(&mut self, job: Job) {
        self.queue.push_back(job.directory.id);
        self.jobs.insert(job.directory.id, job);
    }

    /// A job by number.
    pub(crate) fn get(&self, id: u32) -> Option<&Job> {
        self.jobs.get(&id)
    }

    /// A job by number, to change.
    pub(crate) fn get_mut(&mut self, id: u32) -> Option<&mut Job> {
        self.jobs.get_mut(&id)
    }

    /// The job whose exposures have this key.
    pub(crate) fn by_key(&self, key: u64) -> Option<&Job> {
        // A job whose journal cannot be read has the key 0.
        self.jobs.values().find(|job| job.key == key && key != 0)
    }

    /// Commanded duration of an exposure that may have been under way when the daemon started, milliseconds. `None` unless the
    /// exposure was commanded to this device since its start `boot_id`, and its job is not over: a job may end while its light is on
    /// in a device that is not connected.
    pub(crate) fn commanded_ms(&self, id: ExposureId, boot_id: u32) -> Option<u32> {
        let job = self.by_key(id.job).filter(|job| !job.view.state.is_final())?;
        let commanded = job.past.unconfirmed.filter(|commanded| commanded.boot_id == boot_id)?;
        let is_commanded = id == job.past.passes.id(job.key, commanded.exposure);
        job.unconfirmed_ms.filter(|_| is_commanded)
    }

    /// Every job as operators see it, the oldest first.
    pub(crate) fn views(&self) -> Vec<JobView> {
        self.jobs.values().map(|job| job.view.clone()).collect()
    }

    /// The parts of jobs that are not over and whose resin is not estimated.
    pub(crate) fn unsampled(&self) -> impl Iterator<Item = &JobDirectory> {
        self.jobs.values().filter(|job| job.is_unsampled()).map(|job| &job.directory)
    }

    /// The jobs that are over, and what must stay known of each when its record is deleted.
    pub(crate) fn over(&self) -> Vec<Forgotten> {
        self.jobs.values().filter(|job| job.view.state.is_final()).map(Job::forgotten).collect()
    }

    /// The job that ended last.
    pub(crate) fn last_over(&self) -> Option<&JobView> {
        let views = self.jobs.values().map(|job| &job.view);
        views.filter(|job| job.state.is_final()).max_by_key(|job| job.ended_ms)
    }

    /// The interrupted job whose part still hangs on the plate.
    pub(crate) fn interrupted(&self) -> Option<u32> {
        self.jobs.iter().find(|(_, job)| job.view.state == JobState::Interrupted).map(|(id, _)| *id)
    }

    /// The newest job that says anything about the plate.
    fn last_plate(&self) -> Option<(Forgotten, Option<&Job>)> {
        let jobs = self.jobs.values().map(|job| (job.forgotten(), Some(job)));
        let all = jobs.chain(self.forgotten.values().map(|job| (*job, None)));
        // Jobs begin in the order of their numbers: an interrupted one keeps the machine.
        all.filter(|(job, _)| job.plate != PlateAfter::Unsaid).max_by_key(|(job, _)| job.id)
    }

    /// Number and key of the last job, if no record says that its plate was lifted. An interrupted job does not count: it keeps the
    /// machine.
    pub(crate) fn left(&self) -> Option<(u32, u64)> {
        let (last, job) = self.last_plate()?;
        let is_over = job.is_none_or(|job| job.view.state.is_final());
        (last.plate == PlateAfter::Left && is_over).then_some((last.id, last.key))
    }

    /// The boot of the device on whose plate nothing can hang: it was confirmed to be empty for the last job, and that job has had
    /// no light.
    pub(crate) fn bare_on(&self) -> Option<u32> {
        let (_, job) = self.last_plate()?;
        job.filter(|job| !job.past.touched)?.past.plate_clear_on
    }

    /// What the records say of an exposure that the device shows, for the job `beginning`.
    pub(crate) fn account(&self, trace: Trace, beginning: u32) -> Account {
        let (Trace::Lit { job: key, .. } | Trace::Held { job: key, .. }) = trace;
        let is_told = self.jobs.values().any(|job| job.past.traces.contains(&trace));
        if is_told || self.forgotten.values().any(|job| job.key == key) {
            return Account::Known;
        }
        match self.by_key(key) {
            None => Account::Foreign,
            // A contradiction with its own journal is found by its engine.
            Some(job) if job.directory.id == beginning || matches!(trace, Trace::Held { .. }) => Account::Known,
            Some(job) if job.past.touched && job.view.state.is_final() => Account::Known,
            Some(job) => Account::NotOf(job.directory.id),
        }
    }

    /// A job in the queue that is to get the machine only to end.
    pub(crate) fn ending(&self) -> Option<u32> {
        self.queue.iter().copied().find(|id| {
            self.jobs.get(id).is_some_and(|job| matches!(job.view.state, JobState::Aborting | JobState::Stopping))
        })
    }

    /// Whether an order for any of them is being written.
    pub(crate) fn are_ordered(&self) -> bool {
        self.jobs.values().any(|job| job.ordered)
    }

    /// Puts a job at the front of the queue, as its part hangs on the plate or it had the machine already.
    pub(crate) fn take_up(&mut self, id: u32, take_up: TakeUp) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.take_up = take_up;
            (job.awaits_plate, job.awaits_device) = (false, false);
            job.doubt = None;
            job.view.state = take_up.state_before(JobState::Queued);
            job.view.reason = None;
            self.unqueue(id);
            self.queue.push_front(id);
        }
    }

    /// Queues an interrupted job to end as soon as a device answers.
    pub(crate) fn end_later(&mut self, id: u32, order: EndOrder) {
        self.take_up(id, TakeUp::End(order.into()));
        if let Some(job) = self.jobs.get_mut(&id) {
            job.awaits_device = job.past.touched;
        }
    }

    /// Takes a job out of the queue.
    pub(crate) fn unqueue(&mut self, id: u32) {
        self.queue.retain(|queued| *queued != id);
    }

    /// The first job in the queue; `None` if an order for it is being written, or an interrupted job keeps the machine.
    pub(crate) fn next(&self) -> Option<&Job> {
        let job = self.jobs.get(self.queue.front()?)?;
        (!job.ordered && self.interrupted().is_none()).then_some(job)
    }

    /// Pops the next job. Earlier plate confirmations do not count for the others; if `awaits_plate`, each needs a new one.
    pub(crate) fn take(&mut self, id: u32, awaits_plate: bool) {
        self.unqueue(id);
        for other in &self.queue {
            // A job that is only to end moves no plate down.
            if let Some(job) = self.jobs.get_mut(other).filter(|job| job.is_to_print()) {
                job.awaits_plate = awaits_plate;
                (job.told, job.cleared) = (Vec::new(), Vec::new());
            }
        }
    }

    /// Which job a queued job waits for; `holder` has the machine. `None` if it is next.
    pub(crate) fn ahead_of(&self, id: u32, holder: Option<u32>) -> Option<String> {
        let first = self.queue.front().filter(|first| **first != id);
        match (holder, self.interrupted(), first) {
            (Some(holder), ..) => Some(format!("waits for the end of job {holder}")),
            (None, Some(other), _) => Some(format!(
                "waits for job {other}, which is interrupted and whose part is on the plate: `layerctl resume {other}` or \
                 `layerctl abort {other}` first"
            )),
            (None, None, Some(first)) => Some(format!("waits for job {first}, which is before it in the queue")),
            (None, None, None) => None,
        }
    }

    /// Writes into every queued job's view what it waits for; returns the jobs where that changed. `light` says why the device's
    /// light keeps jobs from printing, `misfit` why the device cannot print the next one.
    pub(crate) fn explain(&mut self, holder: Option<u32>, light: Option<&str>, misfit: Option<&str>) -> Vec<u32> {
        let mut changed = Vec::new();
        for id in self.queue.clone() {
            let ahead = self.ahead_of(id, holder);
            let Some(job) = self.jobs.get_mut(&id) else { continue };
            let reason = match (ahead, job.take_up) {
                (Some(ahead), _) => Some(ahead),
                (None, TakeUp::End(command)) => job.awaits_device.then(|| {
                    let verb = if command == Command::Abort { "aborted" } else { "stopped" };
                    format!(
                        "is {verb} as ordered as soon as the device answers; `layerctl abort {id}` does not wait for it"
                    )
                }),
                _ if light.is_some() => light.map(|light| format!("waits for a dark device: {light}")),
                _ if misfit.is_some() => misfit.map(|misfit| format!("waits for a device that fits: {misfit}")),
                _ if !job.told.is_empty() => Some(sign::text(&job.told, id)),
                _ if job.awaits_plate => {
                    Some(format!("waits for an empty plate: take the last part off, then `layerctl resume {id}`"))
                }
                _ => None,
            };
            if job.view.reason != reason {
                job.view.reason = reason;
                changed.push(id);
            }
        }
        changed
    }

    /// Forgets jobs whose records the spool has deleted, except for their keys and plates.
    pub(crate) fn forget(&mut self, ids: &[u32]) {
        for job in ids.iter().filter_map(|id| self.jobs.remove(id)) {
            self.forgotten.insert(job.directory.id, job.forgotten());
        }
        while self.forgotten.len() > MAX_FORGOTTEN {
            self.forgotten.pop_first();
        }
    }
}
