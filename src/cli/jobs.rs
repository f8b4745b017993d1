//! `layerctl jobs`. `tests/operator/records.rs` shows it.

use std::time::SystemTime;

use clap::Args;

use super::client::Client;
use super::progress::{
    age_text, duration_text, progress_lines, resin_text, short_time_text, took_s, unix_ms, without_eta, zone_text,
};
use super::{block_on, print, print_json};
use crate::api::{JobList, JobView, LinkState};
use crate::job::JobState;
use crate::text::{layer_text, short_name};

/// List the jobs that the daemon remembers, the oldest first.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl jobs                 each job's state, layers done, beginning, duration and end, its part, recipe and resin
  layerctl jobs --json | jq '.jobs[] | select(.state == \"interrupted\") | .id'

BEGAN is when the job got the machine; TOOK counts from there to its end, or until now, pauses included. Times are local ones. Below \
stands what a job waits for or why it ended. `layerctl log JOB` tells more.")]
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
    let now = SystemTime::now();
    let zone = zone_text(unix_ms(now));
    print(&row(["ID", "STATE", "LAYERS DONE", &format!("BEGAN ({zone})"), "TOOK", "ENDED"]))?;
    for job in &jobs {
        print(&job_row(job, unix_ms(now)))?;
        for line in lines(job, link, now) {
            print(&format!("{:<8}{line}", ""))?;
        }
    }
    Ok(())
}

/// One line of the table: it fits 80 columns, and so does the heading.
fn row([id, state, layers, began, took, ended]: [&str; 6]) -> String {
    let row = format!("{id:<7} {state:<11} {layers:>13}  {began:<14} {took:<12} {ended}");
    row.trim_end().into()
}

fn job_row(job: &JobView, now_ms: u64) -> String {
    let layers = format!("{}/{}", job.layers_done, job.layers_total);
    let began = job.started_ms.map(|at_ms| short_time_text(at_ms, now_ms));
    let took = took_s(job, now_ms).map(duration_text);
    // An interrupted job may go on.
    let ended = job.ended_ms.filter(|_| job.state.is_final()).map(|at_ms| short_time_text(at_ms, now_ms));
    let [began, took, ended] = [began, took, ended].map(|text| text.unwrap_or_else(|| "-".into()));
    row([&job.id, job.state.name(), &layers, &began, &took, &ended])
}

/// Lines below a job's row: its part, its progress if it is active, and its notes.
fn lines(job: &JobView, link: LinkState, now: SystemTime) -> Vec<String> {
    let mut job = job.clone();
    without_eta(&mut job, link);
    let progress = if job.state.is_active() { progress_lines(&job, now) } else { Vec::new() };
    std::iter::once(part_line(&job)).chain(progress).chain(notes(&job)).collect()
}

/// Name, recipe and resin of a job, and how long ago it was submitted if it has not begun and is not over.
fn part_line(job: &JobView) -> String {
    // Empty, or 0, if the journal cannot be read.
    let recipe = Some(short_name(&job.recipe)).filter(|name| !name.is_empty()).map(|name| format!("recipe {name}"));
    let submitted = (job.started_ms.is_none() && !job.state.is_final() && job.submitted_ms > 0)
        .then(|| format!("submitted {} ago", age_text(job.submitted_ms)));
    let name = if job.name.is_empty() { "name unknown".into() } else { short_name(&job.name) };
    [Some(name), recipe, resin_text(job), submitted].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// What an operator must know of a job besides its numbers: its reason, and a layer in doubt.
pub(super) fn notes(job: &JobView) -> Vec<String> {
    let mut notes: Vec<String> = job.reason.iter().cloned().collect();
    if let (Some(layer), JobState::Interrupted) = (job.in_doubt, job.state) {
        let layer = layer_text(layer, job.material.as_deref());
        notes.push(format!("{layer} may or may not have been exposed: {}", doubt_commands(&job.id)));
    }
    notes
}

/// The two commands that settle a layer in doubt, each whole: a shell would take `exposed|repeat` for a pipe.
pub(super) fn doubt_commands(id: &str) -> String {
    format!(
        "`layerctl resume {id} --in-doubt exposed` if it was, or `layerctl resume {id} --in-doubt repeat` if it was not"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_fits_eighty_columns_and_the_longest_figures() {
        let text = r#"{"id": "1234567", "name": "a", "state": "interrupted", "recipe": "r", "layers_done": 100000,
            "layers_total": 100000, "layer": null, "eta_s": null, "late_layers": 0, "late_ms_total": 0, "submitted_ms": 1,
            "started_ms": 1767225600000, "ended_ms": 1767425600000, "reason": null, "in_doubt": null}"#;
        let mut job: JobView = serde_json::from_str(text).unwrap();
        let now_ms = 1_767_425_600_000;
        assert_eq!(
            job_row(&job, now_ms),
            "1234567 interrupted 100000/100000   1 Jan 00:00   55 h 33 min  -",
            "it may go on"
        );
        (job.state, job.duration_s) = (JobState::Completed, Some(200_000));
        let long_ago = job_row(&job, now_ms + 400 * 86_400_000);
        assert_eq!(long_ago, "1234567 completed   100000/100000   1 Jan 2026    55 h 33 min   3 Jan 2026");
        assert!(long_ago.len() <= 80);
        (job.started_ms, job.ended_ms, job.duration_s, job.state) = (None, None, None, JobState::Queued);
        assert_eq!(job_row(&job, now_ms), "1234567 queued      100000/100000  -              -            -");
        assert!(part_line(&job).starts_with("a, recipe r, submitted "), "{}", part_line(&job));
    }
}
