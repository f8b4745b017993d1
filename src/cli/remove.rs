//! `layerctl remove JOB...`.

use clap::Args;

use super::client::{Client, ClientError};
use super::{Ending, block_on, mib, print, print_json, report};
use crate::daemon::api::RemovedView;

/// Delete finished jobs, their parts and their records.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl remove 7
  layerctl remove 3 4 5     says for each how much room that made

Only a job that is completed, stopped, aborted or failed can be removed. One that cannot does not keep the others from it; the exit \
code is then 1.")]
pub(super) struct RemoveArgs {
    /// The jobs' ids.
    #[arg(required = true, value_name = "JOB")]
    jobs: Vec<String>,
    /// Print each removed job as one JSON object on a line of its own.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: RemoveArgs) -> anyhow::Result<Ending> {
    let client = Client::from_environment();
    let mut ending = Ending::Done;
    block_on(async {
        for id in args.jobs {
            let removed = match client.remove(&id).await {
                Ok(removed) => removed,
                // The daemon speaks of this job alone; where it does not answer the others fare no better.
                Err(error @ ClientError::Refused { .. }) => {
                    report(&error.into());
                    ending = Ending::Failed;
                    continue;
                }
                Err(error) => return Err(error.into()),
            };
            if args.json {
                print_json(&removed)?;
            } else {
                let RemovedView { id, freed_bytes } = removed;
                print(&format!("job {id} is removed: {:.1} MiB are free again", mib(freed_bytes)))?;
            }
        }
        Ok(ending)
    })
}
