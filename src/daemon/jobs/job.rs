//! One job as the daemon knows it: what operators see of it, and what it waits for. `docs/control-api.md` shows a job as JSON.

use super::past::Past;
use super::resin::Resin;
use super::sign::{MAX_SIGNS, Sign};
use crate::api::JobView;
use crate::config::{Kind, Machine, Recipe};
use crate::daemon::handle::Reply;
use crate::device::Passes;
use crate::job::{
    Command, EndOrder, Entry as JournalEntry, Forgotten, History, JobDirectory, JobState, Journal, LEFTOVER_MS,
    Progress, Record, ResumeChoice, read_journal,
};
use crate::system::unix_ms;

/// One job.
#[derive(Debug)]
pub(crate) struct Job {
    /// Its place in the spool.
    pub directory: JobDirectory,
    /// Names its exposures; 0 where the journal could not be read.
    pub key: u64,
    /// Exposure time of the layer that was commanded and not confirmed when the daemon started, milliseconds.
    pub unconfirmed_ms: Option<u32>,
    /// Machine and recipe it is printed with; `None` for a job that is over, or if its files cannot be read.
    pub made_for: Option<Box<(Machine, Recipe)>>,
    /// What operators see.
    pub view: JobView,
    /// About how much resin its part takes; `None` until that is known.
    resin: Option<Resin>,
    /// Its light and plate so far.
    pub past: Past,
    /// What it gets the machine for.
    pub take_up: TakeUp,
    /// Whether it is to pause before its first layer: the order came while it was opened, or before it had to wait again.
    pub pauses: bool,
    /// Whether the operator must confirm first that the plate is empty, whatever device and spool show.
    pub awaits_plate: bool,
    /// Whether it gets the machine only once a device answers: to carry out an order to end from before a crash or a lost device.
    pub awaits_device: bool,
    /// Signs of a part that the operator was told of and has not confirmed.
    pub told: Vec<Sign>,
    /// Signs that the operator has confirmed.
    pub cleared: Vec<Sign>,
    /// Why the unconfirmed layer is in doubt, and the view's reason before that was added.
    pub doubt: Option<(String, Option<String>)>,
    /// Whether an order is being checked against its journal or written there. Until that is done, other orders are refused.
    pub ordered: bool,
    /// Aborts that came meanwhile; they are next.
    pub aborts: Vec<Reply>,
    /// Whether it ended and the record of that could not be written. After a restart it is not over, so every order to end it is answered
    /// with a warning.
    pub end_unwritten: bool,
}

/// What a job gets the machine for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum TakeUp {
    /// To print; holds the operator's choice for a layer in doubt.
    Print(ResumeChoice),
    /// To end with the light off and the plate clear: by a stop or an abort.
    End(Command),
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
    /// The job's state until its engine reports one: stopping or aborting, else `otherwise`.
    pub(crate) fn state_before(self, otherwise: JobState) -> JobState {
        match self {
            Self::Print(_) => otherwise,
            Self::End(Command::Abort) => JobState::Aborting,
            Self::End(_) => JobState::Stopping,
        }
    }
}

impl Job {
    /// A job just accepted.
    pub(crate) fn accepted(
        directory: JobDirectory,
        key: u64,
        passes: Passes,
        name: String,
        machine: Machine,
        recipe: Recipe,
    ) -> Self {
        let mut view = JobView::queued(directory.id.to_string());
        view.name = name;
        view.recipe = recipe.name().into();
        view.layers_total = passes.layer_count();
        view.submitted_ms = unix_ms();
        let made_for = Some(Box::new((machine, recipe)));
        Self { made_for, ..Self::new(directory, key, view, Past::of_new(passes), false) }
    }

    fn new(directory: JobDirectory, key: u64, view: JobView, past: Past, awaits_plate: bool) -> Self {
        Self {
            directory,
            key,
            unconfirmed_ms: None,
            made_for: None,
            view,
            resin: None,
            past,
            take_up: TakeUp::Print(ResumeChoice::None),
            pauses: false,
            awaits_plate,
            awaits_device: false,
            told: Vec::new(),
            cleared: Vec::new(),
            doubt: None,
            ordered: false,
            aborts: Vec::new(),
            end_unwritten: false,
        }
    }

    /// Reads a job of the spool.
    pub(crate) fn load(directory: JobDirectory, awaits_plate: bool) -> Self {
        let mut view = JobView::queued(directory.id.to_string());
        let (key, past) = match read_journal(&directory.journal()) {
            Ok((entries, history)) => {
                fill_view(&mut view, &entries, &history);
                tell_dropped(directory.id, &history);
                (history.key, Past::from(&history))
            }
            Err(error) => {
                tracing::error!(job = directory.id, "{error}");
                // The journal may become readable again; until then its part may be on the plate.
                view.state = if error.may_be_mended() { JobState::Interrupted } else { JobState::Failed };
                view.reason = Some(format!("{error}. If its part is on the plate, take it off"));
                (0, Past::unknown())
            }
        };
        let recipe = Recipe::load(&directory.recipe()).ok();
        let unconfirmed_ms = past.unconfirmed.zip(recipe.as_ref()).map(|(commanded, recipe)| {
            recipe.layer_exposure_ms(past.passes.at(commanded.exposure).layer).unwrap_or(LEFTOVER_MS)
        });
        view.recipe = recipe.as_ref().map_or_else(String::new, |recipe| recipe.name().into());
        let made_for = recipe
            .filter(|_| !view.state.is_final())
            .and_then(|recipe| Some(Box::new((Machine::load(&directory.machine()).ok()?, recipe))));
        let awaits_plate = awaits_plate && view.state == JobState::Queued;
        let resin = Resin::load(&directory);
        let mut job = Self { unconfirmed_ms, made_for, ..Self::new(directory, key, view, past, awaits_plate) };
        resin.into_iter().for_each(|resin| job.set_resin(resin));
        job
    }

    /// Whether it is still to be found out how much resin its part takes: only machines with a vat take resin.
    pub(crate) fn is_unsampled(&self) -> bool {
        let has_vat = self.made_for.as_ref().is_some_and(|made_for| made_for.0.kind() == Kind::Dlp);
        has_vat && self.resin.is_none() && !self.view.state.is_final()
    }

    /// Notes about how much resin its part takes.
    pub(crate) fn set_resin(&mut self, resin: Resin) {
        self.resin = Some(resin);
        self.show_resin();
    }

    fn show_resin(&mut self) {
        let Self { resin, view, .. } = self;
        view.resin_ml = resin.as_ref().map(Resin::total_ml);
        view.resin_done_ml = resin.as_ref().map(|resin| resin.layers_ml(view.layers_done, view.layers_total));
    }

    /// What must stay known of it when its record is deleted.
    pub(crate) fn forgotten(&self) -> Forgotten {
        Forgotten { id: self.directory.id, key: self.key, plate: self.past.plate_after() }
    }

    /// Whether it may ever have had the machine, so that plate and light may be its own.
    pub(crate) fn has_begun(&self) -> bool {
        // Key 0: its journal could not be read, so it may have.
        self.view.started_ms.is_some() || self.key == 0
    }

    /// Copies the engine's progress into the view. Returns whether anything changed.
    pub(crate) fn update(&mut self, progress: &Progress) -> bool {
        let before = self.view.clone();
        let view = &mut self.view;
        view.state = progress.state;
        view.layers_done = progress.layers_done;
        view.layers_total = progress.layers_total;
        view.layer = progress.state.is_active().then_some(progress.layer);
        view.material = progress.material.clone().filter(|_| !progress.state.is_final());
        // Whole seconds, so that the view does not change every millisecond.
        view.eta_s = progress.eta_ms.map(|eta_ms| eta_ms.div_ceil(1000));
        view.late_layers = progress.late_layers;
        view.late_ms_total = progress.late_ms_total;
        view.in_doubt = progress.in_doubt;
        view.reason = Some(progress.reason.clone()).filter(|reason| !reason.is_empty());
        // While it is checked, nothing is commanded, and a job that ends then has not begun.
        let prints = matches!(progress.state, JobState::Printing | JobState::Pausing | JobState::Paused);
        if view.started_ms.is_none() && prints {
            view.started_ms = Some(unix_ms());
        }
        if !progress.state.is_active() && view.ended_ms.is_none() {
            view.ended_ms = Some(unix_ms());
        }
        if progress.state.is_active() {
            view.ended_ms = None;
        }
        view.duration_s = duration_s(view);
        self.show_resin();
        self.view != before
    }

    /// Sets why the commanded layer is in doubt, or that it is not. Returns whether that changed.
    pub(crate) fn set_doubt(&mut self, exposure: u32, why: Option<String>) -> bool {
        if self.doubt.as_ref().map(|(why, _)| why) == why.as_ref() {
            return false;
        }
        if let Some((_, before)) = self.doubt.take() {
            self.view.reason = before;
        }
        self.view.in_doubt = why.as_ref().map(|_| self.past.passes.at(exposure).layer);
        if let Some(why) = why {
            let before = self.view.reason.take();
            let known = before.as_ref().map_or_else(String::new, |before| format!("{before}; "));
            let layer = self.past.passes.text(exposure);
            self.view.reason = Some(format!("{known}{layer} is in doubt: {why}. Look at the part"));
            self.doubt = Some((why, before));
        }
        true
    }

    /// Notes that the job ended without an engine.
    pub(crate) fn end(&mut self, state: JobState, reason: Option<String>) {
        self.view.state = state;
        self.view.reason = reason;
        self.view.layer = None;
        self.view.material = None;
        self.view.eta_s = None;
        self.view.ended_ms = Some(unix_ms());
        self.view.duration_s = duration_s(&self.view);
        self.log_end();
    }

    /// Writes into the log how and why the job ended.
    pub(crate) fn log_end(&self) {
        let JobView { id, state, layers_done, layers_total, reason, .. } = &self.view;
        let reason = reason.as_deref().unwrap_or("every layer is exposed");
        tracing::info!("job {id} ended: {state} after {layers_done} of {layers_total} layers: {reason}");
    }
}

impl Job {
    /// Whether its journal could not be read, and may become readable. An order for it that is under way comes first.
    pub(crate) fn is_unread(&self) -> bool {
        self.past.unknown && self.view.state == JobState::Interrupted && !self.ordered
    }

    /// Reads it again; `None` if its journal still cannot be read. Blocks.
    pub(crate) fn read_again(directory: JobDirectory, awaits_plate: bool) -> Option<Self> {
        read_journal(&directory.journal()).ok()?;
        Some(Self::load(directory, awaits_plate)).filter(|job| !job.is_unread())
    }

    /// Whether it is to get the machine to print, not to end.
    pub(crate) fn is_to_print(&self) -> bool {
        matches!(self.take_up, TakeUp::Print(_))
    }

    /// Whether the plate must be bare when it begins: it is to print, and has had no light.
    pub(crate) fn needs_bare_plate(&self) -> bool {
        self.is_to_print() && !self.past.touched && !self.past.unknown
    }

    /// Sets the signs that the operator is told of. An earlier sign stays until it is confirmed, even if the device no longer
    /// shows it: raising the plate or losing the position does not empty the vat.
    pub(crate) fn tell(&mut self, signs: Vec<Sign>) {
        let told = std::mem::replace(&mut self.told, signs);
        for sign in told {
            let is_told = self.told.iter().any(|new| match (new, &sign) {
                (Sign::Low { .. }, Sign::Low { .. }) => true,
                (new, sign) => new == sign,
            });
            if !is_told && self.told.len() < MAX_SIGNS {
                self.told.push(sign);
            }
        }
    }

    /// Marks every sign told so far as confirmed.
    pub(crate) fn clear_told(&mut self) {
        let told = std::mem::take(&mut self.told);
        self.cleared.extend(told);
    }
}

/// How long a job took that is over; `None` if it never had the machine.
fn duration_s(view: &JobView) -> Option<u64> {
    let ended_ms = view.ended_ms.filter(|_| view.state.is_final())?;
    view.started_ms.map(|started_ms| ended_ms.saturating_sub(started_ms) / 1000)
}

/// Logs that a damaged record was dropped at the end of a job's journal.
fn tell_dropped(job: u32, history: &History) {
    if let Some(dropped) = &history.dropped {
        tracing::warn!(job, "{dropped}");
    }
}

/// Logs and records that a damaged record was dropped at the end of a journal that was opened to be continued.
pub(crate) fn record_dropped(job: u32, journal: &mut Journal, history: &History) {
    tell_dropped(job, history);
    if let Some(dropped) = &history.dropped
        && let Err(error) = journal.append(Record::Dropped { what: dropped.clone() }, unix_ms())
    {
        tracing::warn!(job, "that cannot be recorded: {error}");
    }
}

fn fill_view(view: &mut JobView, entries: &[JournalEntry], history: &History) {
    let first_at = |wanted: fn(&Record) -> bool| entries.iter().find(|entry| wanted(&entry.record));
    view.name.clone_from(&history.name);
    view.state = history.state;
    let next = history.passes.at(history.next_exposure);
    view.layers_done = next.layer;
    view.layers_total = history.passes.layer_count();
    view.material =
        history.passes.material(history.next_exposure).map(str::to_owned).filter(|_| !history.state.is_final());
    view.submitted_ms = entries.first().map_or(0, |entry| entry.at_unix_ms);
    view.started_ms = first_at(|record| matches!(record, Record::Started { .. })).map(|entry| entry.at_unix_ms);
    if history.state != JobState::Queued {
        view.ended_ms = entries.last().map(|entry| entry.at_unix_ms);
    }
    view.duration_s = duration_s(view);
    let reason = [history.reason.as_str(), history.dropped.as_deref().unwrap_or_default()];
    view.reason = Some(reason.into_iter().filter(|text| !text.is_empty()).collect::<Vec<_>>().join("; "))
        .filter(|reason| !reason.is_empty());
    view.in_doubt = history.in_doubt.is_some().then_some(next.layer);
}
