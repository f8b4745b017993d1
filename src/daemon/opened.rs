//! A job read from the spool, now that its turn has come.

use std::sync::Arc;

use super::clock::unix_ms;
use super::part::Part;
use crate::config::{Machine, Recipe};
use crate::job::{JobDirectory, JobState, Journal, Record, ResumeChoice, StartPoint};

/// A job read from the spool, ready to run.
#[derive(Debug)]
pub(super) struct Opened {
    /// Open to be written on.
    pub journal: Journal,
    /// Names its exposures.
    pub key: u64,
    /// Where the engine takes it up.
    pub start: StartPoint,
    /// As it was when the job was accepted.
    pub recipe: Recipe,
    /// As it was when the job was accepted.
    pub machine: Machine,
    /// Placed on that machine.
    pub part: Arc<Part>,
}

impl Opened {
    /// Opens a job of the spool: journal, recipe, machine and part as they were when it was accepted. Blocks.
    ///
    /// # Errors
    /// A text that says what is missing or does not fit; where the journal can be written, the job's end stands in it.
    pub(super) fn open(
        job: &JobDirectory,
        choice: ResumeChoice,
        threads: usize,
        limit_bytes: u64,
    ) -> Result<Self, String> {
        let (mut journal, history) = Journal::open(&job.journal()).map_err(|error| error.to_string())?;
        let start = history.start(choice).map_err(|error| error.to_string())?;
        let open = || -> Result<_, String> {
            let recipe = Recipe::load(&job.recipe()).map_err(|error| error.to_string())?;
            let machine = Machine::load(&job.machine()).map_err(|error| error.to_string())?;
            let part = Part::open(&job.part(), &machine, &recipe, threads, limit_bytes).map_err(|e| e.to_string())?;
            Ok((recipe, machine, Arc::new(part)))
        };
        match open() {
            Ok((recipe, machine, part)) => Ok(Self { journal, key: history.key, start, recipe, machine, part }),
            Err(text) => {
                // A part that is on the plate stays resumable: whatever is wrong may be mended.
                let state = if history.next_layer == 0 { JobState::Failed } else { JobState::Interrupted };
                journal.append(Record::Ended { state, reason: text.clone() }, unix_ms()).map_err(|e| e.to_string())?;
                Err(text)
            }
        }
    }
}
