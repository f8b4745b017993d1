//! A job that is read from the spool when its turn comes. `printer/turn.rs` opens jobs.

use std::sync::Arc;

use super::job::{TakeUp, record_dropped};
use crate::config::{Machine, Recipe, load_pair};
use crate::device::Passes;
use crate::job::{JobDirectory, JobState, Journal, Process, Record, StartPoint};
use crate::pipeline::{Part, PartError, Placed, Resolution};
use crate::system::unix_ms;

/// A job read from the spool, ready to run.
#[derive(Debug)]
pub(crate) struct Opened {
    /// Open for appending.
    pub journal: Journal,
    /// Names its exposures.
    pub key: u64,
    /// The exposures of its layers.
    pub passes: Passes,
    /// Where the engine begins.
    pub start: StartPoint,
    /// As it was when the job was accepted.
    pub recipe: Recipe,
    /// As it was when the job was accepted.
    pub machine: Machine,
    /// What the machine does for a layer.
    pub process: Process,
    /// The part, placed on that machine.
    pub part: Arc<Part>,
}

/// A job that cannot be printed.
#[derive(Debug)]
pub(crate) struct Unopened {
    /// Why.
    pub text: String,
    /// Its state from now on: interrupted if its part may be on the plate, else failed.
    pub state: JobState,
    /// Whether its journal says that it ended.
    pub is_recorded: bool,
}

impl Opened {
    /// Opens a job of the spool: journal, recipe, machine and part as they were when it was accepted. `has_begun` says
    /// whether it ever had the machine. Blocks.
    ///
    /// # Errors
    /// What is missing or does not fit. The job's end is written to its journal if possible.
    pub(crate) fn open(
        job: &JobDirectory,
        take_up: TakeUp,
        has_begun: bool,
        threads: usize,
        limit_bytes: u64,
    ) -> Result<Self, Unopened> {
        let (mut journal, history) = Journal::open(&job.journal()).map_err(|error| {
            // A journal that cannot be read may become readable; a damaged one stays damaged.
            let state = if has_begun && error.may_be_mended() { JobState::Interrupted } else { JobState::Failed };
            Unopened { text: error.to_string(), state, is_recorded: false }
        })?;
        record_dropped(job.id, &mut journal, &history);
        // A job whose part is on the plate stays resumable: the fault may be mended.
        let state = if history.touched() { JobState::Interrupted } else { JobState::Failed };
        let start = match take_up {
            TakeUp::Print(choice) => history.start(choice),
            TakeUp::End(_) => history.start_to_end(),
        };
        let start = start.map_err(|error| {
            let is_recorded = history.state.is_final();
            Unopened { text: error.to_string(), state, is_recorded }
        })?;
        let open = || -> Result<_, String> {
            let (machine, recipe) = load_pair(&job.machine(), &job.recipe()).map_err(|error| error.to_string())?;
            let process = Process::new(&machine, &recipe)
                .ok_or_else(|| format!("layerd cannot drive machine `{}`", machine.name()))?;
            let part = Placed::open(&job.part(), &Resolution::of(&machine, &recipe))
                .and_then(|placed| placed.fit(threads, limit_bytes))
                .map_err(|error| spool_text(&error))?;
            if part.layer_count() != history.passes.layer_count() {
                let (found, accepted) = (part.layer_count(), history.passes.layer_count());
                return Err(format!(
                    "the part in the spool has {found} layers, the one accepted had {accepted}: it was replaced"
                ));
            }
            if matches!(take_up, TakeUp::Print(_)) && start.next_exposure == 0 && !start.touched {
                part.verify_reach(limit_bytes).map_err(|error| spool_text(&error))?;
                let footing = part.footing(&recipe, limit_bytes).map_err(|error| spool_text(&error))?;
                footing.problem(part.layer_count()).map_or(Ok(()), Err)?;
            }
            Ok((recipe, machine, process, Arc::new(part)))
        };
        match open() {
            Ok((recipe, machine, process, part)) => {
                let (key, passes) = (history.key, history.passes);
                Ok(Self { journal, key, passes, start, recipe, machine, process, part })
            }
            Err(text) => {
                let ended = journal.append(Record::Ended { state, reason: text.clone() }, unix_ms());
                let is_recorded = ended.is_ok();
                Err(Unopened { text: ended.map_or_else(|error| error.to_string(), |()| text), state, is_recorded })
            }
        }
    }
}

/// Why a part in the spool cannot be used. It is a copy, so the advice of an error on the original does not apply. A job whose part is on
/// the plate can be resumed by a daemon with a larger budget.
pub(crate) fn spool_text(error: &PartError) -> String {
    if let Some(damage) = error.damage() {
        return format!(
            "the spool's copy of the part is damaged ({damage}). End this job, start the part again from its original file, and check \
             the spool's disk"
        );
    }
    match error.shortage() {
        Some(exceeded) => format!(
            "{exceeded}. `layerctl check` says how much the part needs: set that as memory_budget in the daemon's configuration, restart \
             the daemon, and resume the job"
        ),
        None => error.to_string(),
    }
}
