//! The jobs the daemon knows: what operators see of each, and who is next.

use std::collections::{BTreeMap, VecDeque};

use super::api::JobView;
use super::clock::unix_ms;
use super::past::Past;
use crate::job::{
    Command, Entry as JournalEntry, Forgotten, History, JobDirectory, JobState, Progress, Record, ResumeChoice,
    Unconfirmed, read_journal,
};
use crate::link::message::ExposureId;

/// One job.
#[derive(Debug)]
pub(super) struct Job {
    /// Its place in the spool.
    pub directory: JobDirectory,
    /// Names its exposures; 0 where the journal could not be read.
    pub key: u64,
    /// Exposure of the layer that was commanded and not confirmed when the daemon started, milliseconds.
    unconfirmed_ms: Option<u32>,
    /// What operators see.
    pub view: JobView,
    /// Its light and plate so far.
    pub past: Past,
    /// What for, when its turn comes.
    pub take_up: TakeUp,
    /// Whether the operator must say first that the plate is clear.
    pub awaits_plate: bool,
    /// Whether an order is being checked or written in its journal; until then nothing else is done with it.
    pub ordered: bool,
    /// An abort came meanwhile; it is carried out next.
    pub abort_ordered: bool,
}

/// What a job is given the machine for.
#[derive(Clone, Copy, Debug)]
pub(super) enum TakeUp {
    /// To print, with what the operator said of a layer in doubt.
    Print(ResumeChoice),
    /// To end, dark and with the plate clear: a stop, or an abort.
    End(Command),
}

/// All jobs, and the queue.
#[derive(Debug, Default)]
pub(super) struct Jobs {
    jobs: BTreeMap<u32, Job>,
    queue: VecDeque<u32>,
}

impl Jobs {
    /// Reads the journals of a spool's jobs. Jobs that were queued still are; they wait for a clear plate where
    /// `awaits_plate`.
    pub(super) fn load(directories: Vec<JobDirectory>, awaits_plate: bool) -> Self {
        let mut jobs = Self::default();
        for directory in directories {
            let job = Job::load(directory, awaits_plate);
            if job.view.state == JobState::Queued {
                jobs.queue.push_back(job.directory.id);
            }
            jobs.jobs.insert(job.directory.id, job);
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
        self.jobs.values().find(|job| job.key == key)
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

    /// Lets every queued job wait for a word that the plate is clear.
    pub(super) fn await_plate(&mut self) {
        for id in &self.queue {
            if let Some(job) = self.jobs.get_mut(id) {
                job.awaits_plate = matches!(job.take_up, TakeUp::Print(_)) && !job.has_begun();
            }
        }
    }

    /// Whether the job that ended last, as far as the spool tells, may have left its part in the vat.
    pub(super) fn ended_unknown(&self) -> bool {
        let begun = self.jobs.values().filter(|job| job.view.state.is_final() && job.has_begun());
        let last = begun.max_by_key(|job| (job.view.ended_ms.unwrap_or(u64::MAX), job.directory.id));
        last.is_some_and(|job| job.view.state != JobState::Completed)
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
            job.awaits_plate = false;
            job.view.state = take_up.state_before(JobState::Queued);
            job.view.reason = None;
            self.unqueue(id);
            self.queue.push_front(id);
        }
    }

    /// Takes a job out of the queue.
    pub(super) fn unqueue(&mut self, id: u32) {
        self.queue.retain(|queued| *queued != id);
    }

    /// The job whose turn it is, out of the queue; `None` where none waits or the first must wait. From now on its part is on
    /// the plate: what was said of the plate before holds for no other job where `awaits_plate`.
    pub(super) fn take_next(&mut self, awaits_plate: bool) -> Option<u32> {
        let id = *self.queue.front()?;
        let job = self.jobs.get(&id)?;
        if job.ordered || job.awaits_plate || self.interrupted().is_some() {
            return None;
        }
        self.queue.pop_front();
        for other in &self.queue {
            if let Some(job) = self.jobs.get_mut(other) {
                job.awaits_plate = awaits_plate;
            }
        }
        Some(id)
    }

    /// What a queued job waits for besides a word that the plate is clear; `holder` has the machine.
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

    /// Writes into every queued job's view what it waits for; returns those where that changed.
    pub(super) fn explain(&mut self, holder: Option<u32>) -> Vec<u32> {
        let mut changed = Vec::new();
        for id in self.queue.clone() {
            let ahead = self.ahead_of(id, holder);
            let Some(job) = self.jobs.get_mut(&id) else { continue };
            let reason = match (ahead, job.awaits_plate) {
                (None, true) => {
                    Some(format!("waits for a clear plate: take the last part off, then `layerctl resume {id}`"))
                }
                (ahead, _) => ahead,
            };
            if job.view.reason != reason {
                job.view.reason = reason;
                changed.push(id);
            }
        }
        changed
    }

    /// Forgets jobs whose records the spool has deleted.
    pub(super) fn forget(&mut self, ids: &[u32]) {
        self.jobs.retain(|id, _| !ids.contains(id));
    }
}

impl TakeUp {
    /// What the job is until its engine says so itself: on its way to the end, or `otherwise`.
    pub(super) fn state_before(self, otherwise: JobState) -> JobState {
        match self {
            Self::Print(_) => otherwise,
            Self::End(Command::Abort) => JobState::Aborting,
            Self::End(_) => JobState::Stopping,
        }
    }
}

impl Job {
    /// A job just accepted.
    pub(super) fn accepted(directory: JobDirectory, key: u64, layer_count: u32, name: String, recipe: String) -> Self {
        let mut view = blank_view(&directory);
        view.name = name;
        view.recipe = recipe;
        view.layers_total = layer_count;
        view.submitted_ms = unix_ms();
        Self::new(directory, key, view, Past::default(), false)
    }

    fn new(directory: JobDirectory, key: u64, view: JobView, past: Past, awaits_plate: bool) -> Self {
        Self {
            directory,
            key,
            unconfirmed_ms: None,
            view,
            past,
            take_up: TakeUp::Print(ResumeChoice::None),
            awaits_plate,
            ordered: false,
            abort_ordered: false,
        }
    }

    fn load(directory: JobDirectory, awaits_plate: bool) -> Self {
        let mut view = blank_view(&directory);
        let (key, past) = match read_journal(&directory.journal()) {
            Ok((entries, history)) => {
                fill_view(&mut view, &entries, &history);
                (history.key, Past::from(&history))
            }
            Err(error) => {
                tracing::error!(job = directory.id, "{error}");
                // What is there and cannot be read now may be read later; until then its part may be on the plate.
                view.state = if error.may_be_mended() { JobState::Interrupted } else { JobState::Failed };
                view.reason = Some(format!("{error}. If its part is on the plate, take it off"));
                (0, Past::unknown())
            }
        };
        let recipe = crate::config::Recipe::load(&directory.recipe()).ok();
        let unconfirmed_ms =
            past.unconfirmed.and_then(|commanded| Some(recipe.as_ref()?.layer_exposure_ms(commanded.layer)));
        view.recipe = recipe.map_or_else(String::new, |recipe| recipe.name);
        let awaits_plate = awaits_plate && view.state == JobState::Queued;
        Self { unconfirmed_ms, ..Self::new(directory, key, view, past, awaits_plate) }
    }

    /// What must be known of it once its record is gone.
    pub(super) fn forgotten(&self) -> Forgotten {
        Forgotten { id: self.directory.id, key: self.key, plate: self.past.plate_after() }
    }

    /// Whether it ever had the machine, so that plate and light may be its own.
    pub(super) fn has_begun(&self) -> bool {
        // Without a key its journal could not be read, and nobody knows.
        self.view.started_ms.is_some() || self.key == 0
    }

    /// Takes over what the engine says. Returns whether anything changed.
    pub(super) fn update(&mut self, progress: &Progress) -> bool {
        let before = self.view.clone();
        let view = &mut self.view;
        view.state = progress.state;
        view.layers_done = progress.layers_done;
        view.layers_total = progress.layers_total;
        view.layer = progress.state.is_active().then_some(progress.layer);
        // Whole seconds: a view does not change with every millisecond.
        view.eta_s = progress.eta_ms.map(|eta_ms| eta_ms.div_ceil(1000));
        view.late_layers = progress.late_layers;
        view.late_ms_total = progress.late_ms_total;
        view.in_doubt = progress.in_doubt;
        view.reason = Some(progress.reason.clone()).filter(|reason| !reason.is_empty());
        if view.started_ms.is_none() && progress.state.is_active() {
            view.started_ms = Some(unix_ms());
        }
        if !progress.state.is_active() && view.ended_ms.is_none() {
            view.ended_ms = Some(unix_ms());
        }
        if progress.state.is_active() {
            view.ended_ms = None;
        }
        *view != before
    }

    /// The job ended without an engine.
    pub(super) fn end(&mut self, state: JobState, reason: Option<String>) {
        self.view.state = state;
        self.view.reason = reason;
        self.view.layer = None;
        self.view.eta_s = None;
        self.view.ended_ms = Some(unix_ms());
        self.log_end();
    }

    /// Writes into the log how and why the job ended.
    pub(super) fn log_end(&self) {
        let JobView { id, state, layers_done, layers_total, reason, .. } = &self.view;
        let reason = reason.as_deref().unwrap_or("every layer is exposed");
        tracing::info!("job {id} ended: {state} after {layers_done} of {layers_total} layers: {reason}");
    }
}

fn blank_view(directory: &JobDirectory) -> JobView {
    JobView {
        id: directory.id.to_string(),
        name: String::new(),
        state: JobState::Queued,
        recipe: String::new(),
        layers_done: 0,
        layers_total: 0,
        layer: None,
        eta_s: None,
        late_layers: 0,
        late_ms_total: 0,
        submitted_ms: 0,
        started_ms: None,
        ended_ms: None,
        reason: None,
        in_doubt: None,
    }
}

fn fill_view(view: &mut JobView, entries: &[JournalEntry], history: &History) {
    let first_at = |wanted: fn(&Record) -> bool| entries.iter().find(|entry| wanted(&entry.record));
    view.name.clone_from(&history.name);
    view.state = history.state;
    view.layers_done = history.next_layer;
    view.layers_total = history.layer_count;
    view.submitted_ms = entries.first().map_or(0, |entry| entry.at_unix_ms);
    view.started_ms = first_at(|record| matches!(record, Record::Started { .. })).map(|entry| entry.at_unix_ms);
    if history.state != JobState::Queued {
        view.ended_ms = entries.last().map(|entry| entry.at_unix_ms);
    }
    view.reason = Some(history.reason.clone()).filter(|reason| !reason.is_empty());
    view.in_doubt = history.in_doubt.is_some().then_some(history.next_layer);
}
