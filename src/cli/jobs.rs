//! `layerctl jobs`.

use std::time::{Duration, SystemTime};

use clap::Args;
use time::OffsetDateTime;

use super::client::Client;
use super::{block_on, duration_text, print, print_json};
use crate::daemon::api::{JobList, JobView};
use crate::job::JobState;
use crate::text::short_name;

/// List the jobs the daemon remembers, the oldest first.
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
        return print("no jobs remembered; `layerctl start FILE` makes one");
    }
    print(&format!("{:<10} {:<12} {:>13} {:>14}  {}", "ID", "STATE", "LAYERS DONE", "SUBMITTED", "NAME"))?;
    for job in &jobs {
        let layers = format!("{}/{}", job.layers_done, job.layers_total);
        // 0 where the journal, which alone knows, cannot be read.
        let age = match job.submitted_ms {
            0 => "unknown".into(),
            since_ms => format!("{} ago", age_text(since_ms)),
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

/// How long ago a time in Unix milliseconds was.
pub(super) fn age_text(since_ms: u64) -> String {
    let since = SystemTime::UNIX_EPOCH + Duration::from_millis(since_ms);
    duration_text(SystemTime::now().duration_since(since).map_or(0, |age| age.as_secs()))
}

/// A time in Unix milliseconds, the same for every place and language: `2026-01-31 08:05 UTC`.
pub(super) fn time_text(unix_ms: u64) -> String {
    let seconds = i64::try_from(unix_ms / 1000).unwrap_or(i64::MAX);
    OffsetDateTime::from_unix_timestamp(seconds).map_or_else(
        |_| "at an unknown time".into(),
        |at| {
            let (year, month, day) = (at.year(), u8::from(at.month()), at.day());
            format!("{year}-{month:02}-{day:02} {:02}:{:02} UTC", at.hour(), at.minute())
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_read_the_same_everywhere() {
        assert_eq!(time_text(1_767_225_600_000), "2026-01-01 00:00 UTC");
        assert_eq!(time_text(u64::MAX), "at an unknown time");
    }
}
