//! `layerctl jobs`.

use std::time::{Duration, SystemTime};

use clap::Args;

use super::client::Client;
use super::{block_on, duration_text, print, print_json};
use crate::daemon::api::{JobList, JobView};
use crate::job::JobState;
use crate::text::short_name;

/// List the jobs the daemon remembers.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl jobs
  layerctl jobs --json | jq '.jobs[] | select(.state == \"interrupted\") | .id'")]
pub(super) struct JobsArgs {
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &JobsArgs) -> anyhow::Result<()> {
    let jobs = block_on(async { Ok(Client::from_environment().jobs().await?) })?;
    if args.json {
        return print_json(&JobList { jobs });
    }
    if jobs.is_empty() {
        return print("no jobs yet; `layerctl start FILE` makes one");
    }
    print(&format!("{:<10} {:<12} {:>13} {:>14}  {}", "ID", "STATE", "LAYERS", "SUBMITTED", "NAME"))?;
    for job in &jobs {
        let layers = format!("{}/{}", job.layers_done, job.layers_total);
        // 0 where the journal, which alone knows, cannot be read.
        let age = match job.submitted_ms {
            0 => "unknown".into(),
            since_ms => format!("{} ago", duration_text(age_s(since_ms))),
        };
        print(&format!("{:<10} {:<12} {layers:>13} {age:>14}  {}", job.id, job.state.name(), short_name(&job.name)))?;
        for line in notes(job) {
            print(&format!("{:<10} {line}", ""))?;
        }
    }
    Ok(())
}

/// What an operator must know of a job beyond its numbers.
pub(super) fn notes(job: &JobView) -> Vec<String> {
    let mut notes: Vec<String> = job.reason.iter().cloned().collect();
    if let (Some(layer), JobState::Interrupted) = (job.in_doubt, job.state) {
        let id = &job.id;
        notes.push(format!(
            "layer {layer} may or may not have been exposed: layerctl resume {id} --in-doubt exposed|repeat"
        ));
    }
    notes
}

fn age_s(since_ms: u64) -> u64 {
    let since = SystemTime::UNIX_EPOCH + Duration::from_millis(since_ms);
    SystemTime::now().duration_since(since).map_or(0, |age| age.as_secs())
}
