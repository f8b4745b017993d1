//! The jobs the daemon knows: what operators see of each, and who is next.

use std::collections::{BTreeMap, VecDeque};

use super::api::JobView;
use super::background::Reply;
use super::clock::unix_ms;
use super::past::Past;
use super::plate::{self, Sign};
use crate::job::{
    Command, EndOrder, Entry as JournalEntry, Forgotten, History, JobDirectory, JobState, MAX_FORGOTTEN, PlateAfter,
    Progress, Record, ResumeChoice, Trace, Unconfirmed, read_journal,
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
    /// Whether the operator must say first that the plate is empty, whatever device and spool show.
    pub awaits_plate: bool,
    /// Whether it is taken up only once a device answers: nobody who could wait for it asked just now.
    pub awaits_device: bool,
    /// What the operator was told of the plate and has not answered.
    pub told: Vec<Sign>,
    /// What the operator knows of the plate.
    pub cleared: Vec<Sign>,
    /// What the device says of the unconfirmed layer, where that leaves it in doubt, and the job's reason before.
    pub doubt: Option<(String, Option<String>)>,
    /// Whether an order is being checked or written in its journal; until then nothing else is done with it.
    pub ordered: bool,
    /// Aborts that came meanwhile; they are carried out next.
    pub aborts: Vec<Reply>,
}

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

impl From<EndOrder> for Command {
    fn from(order: EndOrder) -> Self {
        match order {
            EndOrder::Stop => Self::Stop,
            EndOrder::Abort => Self::Abort,
        }
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
            awaits_device: false,
            told: Vec::new(),
            cleared: Vec::new(),
            doubt: None,
            ordered: false,
            aborts: Vec::new(),
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
        // While it is checked nothing is commanded yet.
        if view.started_ms.is_none() && progress.state.is_active() && progress.state != JobState::Checking {
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

    /// Takes over what the device makes of the layer commanded: whether it is in doubt, and why. Returns whether that is news.
    pub(super) fn set_doubt(&mut self, layer: u32, why: Option<String>) -> bool {
        if self.doubt.as_ref().map(|(why, _)| why) == why.as_ref() {
            return false;
        }
        if let Some((_, before)) = self.doubt.take() {
            self.view.reason = before;
        }
        self.view.in_doubt = why.as_ref().map(|_| layer);
        if let Some(why) = why {
            let before = self.view.reason.take();
            let known = before.as_ref().map_or_else(String::new, |before| format!("{before}; "));
            self.view.reason = Some(format!("{known}layer {layer} is in doubt: {why}. Look at the part"));
            self.doubt = Some((why, before));
        }
        true
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
        warning: None,
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
