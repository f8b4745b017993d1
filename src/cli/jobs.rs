//! `layerctl jobs`.

use std::time::SystemTime;

use clap::Args;

use super::client::Client;
use super::{age_text, block_on, print, print_json, progress_lines, without_eta};
use crate::api::{JobList, JobView, LinkState};
use crate::job::JobState;
use crate::text::short_name;

/// List the jobs that the daemon remembers, the oldest first.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl jobs                 each job's id, state, layers done and age; below, what it waits for or why it ended
  layerctl jobs --json | jq '.jobs[] | select(.state == \"interrupted\") | .id'")]
pub(super) struct JobsArgs {
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &JobsArgs) -> anyhow::Result<()> {
    let client = Client::from_environment();
    if args.json {
        let jobs = block_on(async { Ok(client.jobs().await?) })?;
        return print_json(&JobList { jobs });
    }
    let (jobs, link) = block_on(async { Ok((client.jobs().await?, client.status().await?.link.state)) })?;
    if jobs.is_empty() {
        return print("no jobs remembered; `layerctl start FILE` submits one");
    }
    print(&format!("{:<10} {:<12} {:>13} {:>14}  {}", "ID", "STATE", "LAYERS DONE", "SUBMITTED", "NAME"))?;
    for job in &jobs {
        let layers = format!("{}/{}", job.layers_done, job.layers_total);
        // 0 if the journal cannot be read.
        let age = match job.submitted_ms {
            0 => "unknown".into(),
            since_ms => format!("{} ago", age_text(since_ms)),
        };
        print(&format!("{:<10} {:<12} {layers:>13} {age:>14}  {}", job.id, job.state.name(), short_name(&job.name)))?;
        for line in lines(job, link) {
            print(&format!("{:<10} {line}", ""))?;
        }
    }
    Ok(())
}

/// Lines below a job's row: its progress if it is active, and its notes.
fn lines(job: &JobView, link: LinkState) -> Vec<String> {
    let mut job = job.clone();
    without_eta(&mut job, link);
    let progress = if job.state.is_active() { progress_lines(&job, SystemTime::now()) } else { Vec::new() };
    progress.into_iter().chain(notes(&job)).collect()
}

/// What an operator must know of a job besides its numbers: its reason, and a layer in doubt.
pub(super) fn notes(job: &JobView) -> Vec<String> {
    let mut notes: Vec<String> = job.reason.iter().cloned().collect();
    if let (Some(layer), JobState::Interrupted) = (job.in_doubt, job.state) {
        notes.push(format!("layer {layer} may or may not have been exposed: {}", doubt_commands(&job.id)));
    }
    notes
}

/// The two commands that settle a layer in doubt, each whole: a shell would take `exposed|repeat` for a pipe.
pub(super) fn doubt_commands(id: &str) -> String {
    format!(
        "`layerctl resume {id} --in-doubt exposed` if it was, or `layerctl resume {id} --in-doubt repeat` if it was not"
    )
}
