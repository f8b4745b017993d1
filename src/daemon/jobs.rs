//! The jobs the daemon knows: what operators see of each, and who is next.

use std::collections::{BTreeMap, VecDeque};

use super::api::JobView;
use super::job::{Job, TakeUp};
use super::plate;
use crate::job::{Command, EndOrder, Forgotten, JobDirectory, JobState, MAX_FORGOTTEN, PlateAfter, Trace, Unconfirmed};
use crate::link::message::ExposureId;

/// What is known of a layer that a device speaks of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Account {
    /// Here is a record of it, or the operator knows of it.
    Known,
    /// This job's journal knows nothing of it.
    NotOf(u32),
    /// No job here has that key.
    Foreign,
}

/// All jobs, and the queue.
#[derive(Debug, Default)]
pub(super) struct Jobs {
    jobs: BTreeMap<u32, Job>,
    queue: VecDeque<u32>,
    /// Jobs whose records are gone.
    forgotten: BTreeMap<u32, Forgotten>,
}

impl Jobs {
    /// Reads the journals of a spool's jobs. Jobs that were queued still are; they wait for an empty plate where
    /// `awaits_plate`. What was ordered to end before a crash is done so once a device answers.
    pub(super) fn load(directories: Vec<JobDirectory>, forgotten: Vec<Forgotten>, awaits_plate: bool) -> Self {
        let forgotten = forgotten.into_iter().map(|job| (job.id, job)).collect();
        let mut jobs = Self { forgotten, ..Self::default() };
        for directory in directories {
            let (id, job) = (directory.id, Job::load(directory, awaits_plate));
            let (state, ordered) = (job.view.state, job.past.ordered);
            jobs.jobs.insert(id, job);
            match (state, ordered) {
                (JobState::Queued, _) => jobs.queue.push_back(id),
                (JobState::Interrupted, Some(order)) => jobs.end_later(id, order),
                _ => {}
            }
        }
        jobs
    }

    /// Takes a new job in, at the end of the queue.
    pub(super) fn accept(&mut self, job: Job) {
        self.queue.push_back(job.directory.id);
        self.jobs.insert(job.directory.id, job);
    }

    /// A job by number.
    pub(super) fn get(&self, id: u32) -> Option<&Job> {
        self.jobs.get(&id)
    }

    /// A job by number, to change.
    pub(super) fn get_mut(&mut self, id: u32) -> Option<&mut Job> {
        self.jobs.get_mut(&id)
    }

    /// The job whose exposures bear this key.
    pub(super) fn by_key(&self, key: u64) -> Option<&Job> {
        // 0 is the key of none: a job has it whose journal cannot be read.
        self.jobs.values().find(|job| job.key == key && key != 0)
    }

    /// How long an exposure was commanded to last that may be under way since before the daemon started, milliseconds; `None`
    /// where it was not commanded to the device since its start `boot_id`.
    pub(super) fn commanded_ms(&self, id: ExposureId, boot_id: u32) -> Option<u32> {
        let job = self.by_key(id.job)?;
        let commanded = Some(Unconfirmed { layer: id.layer, boot_id });
        job.unconfirmed_ms.filter(|_| job.past.unconfirmed == commanded)
    }

    /// Every job as operators see it, the oldest first.
    pub(super) fn views(&self) -> Vec<JobView> {
        self.jobs.values().map(|job| job.view.clone()).collect()
    }

    /// The jobs to which nothing can happen any more, and what must be known of each once its record is gone.
    pub(super) fn over(&self) -> Vec<Forgotten> {
        self.jobs.values().filter(|job| job.view.state.is_final()).map(Job::forgotten).collect()
    }

    /// The interrupted job whose part still hangs on the plate.
    pub(super) fn interrupted(&self) -> Option<u32> {
        self.jobs.iter().find(|(_, job)| job.view.state == JobState::Interrupted).map(|(id, _)| *id)
    }

    /// The newest job that tells anything about the plate: what it tells.
    fn last_plate(&self) -> Option<(Forgotten, Option<&Job>)> {
        let jobs = self.jobs.values().map(|job| (job.forgotten(), Some(job)));
        let all = jobs.chain(self.forgotten.values().map(|job| (*job, None)));
        // Jobs begin in the order of their numbers: an interrupted one keeps the machine.
        all.filter(|(job, _)| job.plate != PlateAfter::Unsaid).max_by_key(|(job, _)| job.id)
    }

    /// Number and key of the job whose part may lie in the vat, as far as the spool tells. An interrupted one does not count:
    /// it keeps the machine.
    pub(super) fn left(&self) -> Option<(u32, u64)> {
        let (last, job) = self.last_plate()?;
        let is_over = job.is_none_or(|job| job.view.state.is_final());
        (last.plate == PlateAfter::Left && is_over).then_some((last.id, last.key))
    }

    /// The start of the device whose plate only a job that had no light yet has moved since it was bare.
    pub(super) fn bare_on(&self) -> Option<u32> {
        let (_, job) = self.last_plate()?;
        job.filter(|job| !job.past.touched)?.past.plate_clear_on
    }

    /// What is known here of what a device shows, for a job about to begin.
    pub(super) fn account(&self, trace: Trace, beginning: u32) -> Account {
        let (Trace::Lit { job: key, .. } | Trace::Held { job: key, .. }) = trace;
        let is_told = self.jobs.values().any(|job| job.past.traces.contains(&trace));
        if is_told || self.forgotten.values().any(|job| job.key == key) {
            return Account::Known;
        }
        match self.by_key(key) {
            None => Account::Foreign,
            // What contradicts its own journal is for its engine to find.
            Some(job) if job.directory.id == beginning || matches!(trace, Trace::Held { .. }) => Account::Known,
            Some(job) if job.past.touched && job.view.state.is_final() => Account::Known,
            Some(job) => Account::NotOf(job.directory.id),
        }
    }

    /// A job that is to be given the machine only to end.
    pub(super) fn ending(&self) -> Option<u32> {
        self.queue.iter().copied().find(|id| {
            self.jobs.get(id).is_some_and(|job| matches!(job.view.state, JobState::Aborting | JobState::Stopping))
        })
    }

    /// Puts an interrupted job in front of the queue: its part hangs on the plate.
    pub(super) fn take_up(&mut self, id: u32, take_up: TakeUp) {
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

    /// Gives an interrupted job the machine to end, as soon as a device answers.
    pub(super) fn end_later(&mut self, id: u32, order: EndOrder) {
        self.take_up(id, TakeUp::End(order.into()));
        if let Some(job) = self.jobs.get_mut(&id) {
            job.awaits_device = job.past.touched;
        }
    }

    /// Takes a job out of the queue.
    pub(super) fn unqueue(&mut self, id: u32) {
        self.queue.retain(|queued| *queued != id);
    }

    /// The first job in the queue, where nothing but the machine itself may keep it.
    pub(super) fn next(&self) -> Option<&Job> {
        let job = self.jobs.get(self.queue.front()?)?;
        (!job.ordered && self.interrupted().is_none()).then_some(job)
    }

    /// Takes a job whose turn has come out of the queue. From now on its part is on the plate: what was said of the plate
    /// before holds for no other job where `awaits_plate`.
    pub(super) fn take(&mut self, id: u32, awaits_plate: bool) {
        self.unqueue(id);
        for other in &self.queue {
            if let Some(job) = self.jobs.get_mut(other) {
                job.awaits_plate = awaits_plate;
                (job.told, job.cleared) = (Vec::new(), Vec::new());
            }
        }
    }

    /// What a queued job waits for besides a word that the plate is empty; `holder` has the machine.
    pub(super) fn ahead_of(&self, id: u32, holder: Option<u32>) -> Option<String> {
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

    /// Writes into every queued job's view what it waits for; returns those where that changed. `light` is why none may print.
    pub(super) fn explain(&mut self, holder: Option<u32>, light: Option<&str>) -> Vec<u32> {
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
                _ if !job.told.is_empty() => Some(plate::text(&job.told, id)),
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

    /// Forgets jobs whose records the spool has deleted, but for what must still be known.
    pub(super) fn forget(&mut self, ids: &[u32]) {
        for job in ids.iter().filter_map(|id| self.jobs.remove(id)) {
            self.forgotten.insert(job.directory.id, job.forgotten());
        }
        while self.forgotten.len() > MAX_FORGOTTEN {
            self.forgotten.pop_first();
        }
    }
}
