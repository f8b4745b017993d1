//! `layerctl start --again`: a new job with the part of one that is over. The part is not copied: both jobs have one file.
//! `tests/operator/again.rs` shows it.

use std::sync::{Arc, Mutex, PoisonError};

use super::submit::spool_error;
use crate::config::{ConfigError, read_text};
use crate::daemon::error::OrderError;
use crate::daemon::handle::{Again, Reply, Submission};
use crate::daemon::printer::Printer;
use crate::job::{JobDirectory, JobState, MAX_PARTS, Spool, SpoolError};
use crate::pipeline::PartError;

impl Printer {
    /// Makes a new job of the part of one that is over, in the background. It is checked as any other new job.
    pub(crate) fn print_again(&mut self, again: Again, reply: Reply) {
        let (directory, name) = match self.repeatable(&again.id) {
            Ok(found) => found,
            Err(error) => {
                // The client may be gone.
                let _ = reply.send(Err(error));
                return;
            }
        };
        let (spool, jobs_ended) = (Arc::clone(&self.spool), again.jobs_ended);
        self.take_in(jobs_ended, move || submission(&spool, &directory, name, again), damage_text, reply);
    }

    /// Directory and name of a job whose part can be printed again.
    fn repeatable(&mut self, id: &str) -> Result<(JobDirectory, String), OrderError> {
        let id = self.find(id)?;
        let job = self.waiting(id)?;
        let state = job.view.state;
        if !state.is_final() {
            let end = match state {
                JobState::Interrupted => {
                    format!("`layerctl resume {id}` goes on with it, `layerctl abort {id}` ends it")
                }
                _ => "wait for its end, or start its build file".into(),
            };
            let text = format!("job {id} is {state}; only the part of a job that is over can be printed again: {end}");
            return Err(OrderError::new(409, text));
        }
        // Its journal cannot be read.
        let name = if job.view.name.is_empty() { format!("part of job {id}") } else { job.view.name.clone() };
        Ok((job.directory.clone(), name))
    }
}

/// The new job as if it had been received. Blocks.
fn submission(spool: &Mutex<Spool>, old: &JobDirectory, name: String, again: Again) -> Result<Submission, OrderError> {
    let Again { recipe_text, recipe_name, jobs_ended, .. } = again;
    let id = old.id;
    let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
    let part = spool.part_again(old).map_err(|error| match &error {
        SpoolError::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound => gone(id),
        _ => spool_error(&error),
    })?;
    let (recipe_text, recipe_name) = match recipe_text {
        Some(text) => (text, recipe_name),
        None => (read_text(&old.recipe()).map_err(|error| no_recipe(id, &error))?, Some(format!("recipe of job {id}"))),
    };
    Ok(Submission { part, name, recipe_text: Some(recipe_text), recipe_name, jobs_ended })
}

/// The file in the spool is a copy, so the advice of [`PartError`] on the original does not apply.
fn damage_text(error: &PartError) -> String {
    error.damage().map_or_else(
        || error.to_string(),
        |damage| {
            format!(
                "the spool's copy of the part is damaged ({damage}): start the part from its original file, and check the spool's disk"
            )
        },
    )
}

fn gone(id: u32) -> OrderError {
    let text = format!(
        "the part of job {id} is no longer in the spool, which keeps those of the newest {MAX_PARTS} jobs that are over: start its \
         build file (`layerctl start FILE`)"
    );
    OrderError::new(409, text)
}

fn no_recipe(id: u32, error: &ConfigError) -> OrderError {
    OrderError::new(500, format!("the recipe of job {id} cannot be read ({error}); name one with --recipe"))
}
