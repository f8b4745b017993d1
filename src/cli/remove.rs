//! `layerctl remove JOB...`. `tests/orders.rs` tests it.

use clap::Args;

use super::client::{Client, ClientError};
use super::{Ending, block_on, print, print_json, report};
use crate::api::RemovedView;
use crate::text::size_text;

/// Delete jobs that are over, with their parts and records.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl remove 7         deletes job 7 and tells how much room that makes
  layerctl remove 3 4 5

Only a job that is completed, stopped, aborted or failed can be removed. If one cannot be removed, the others still are, and the \
exit code is 1.")]
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
                // Only this job is refused. Any other error would meet the remaining jobs too.
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
                print(&format!("job {id} is removed: {} free again", size_text(freed_bytes)))?;
            }
        }
        Ok(ending)
    })
}
