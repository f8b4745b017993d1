//! `layerctl status`. `tests/operator` shows it.

use std::time::SystemTime;

use clap::Args;

use super::client::Client;
use super::jobs::notes;
use super::progress::{about_ml_text, age_text, progress_lines, resin_text, time_text, without_eta};
use super::{block_on, print, print_json};
use crate::api::{JobView, Status};
use crate::text::{count_text, short_name, size_text};

/// Show machine, line, jobs, memory and traffic.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl status                                   the job that prints, the queue, the job that ended last
  layerctl status --json | jq .active.layers_done

\"812 of 3000 layers done\" means layers 0 to 811. Single layers are numbered from 0, like their files. The time to go, and the time \
of day at which the print will be done, are estimates from the last layers; they are missing while nothing is printed. The volume of \
resin is an estimate, made within seconds after the job was accepted: what the part takes, and how much of it is printed. Times are \
local ones, with their offset from UTC.")]
pub(super) struct StatusArgs {
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &StatusArgs) -> anyhow::Result<()> {
    let status = block_on(async { Ok(Client::from_environment().status().await?) })?;
    if args.json {
        return print_json(&status);
    }
    [machine(&status), work(&status, SystemTime::now()), figures(&status)]
        .concat()
        .iter()
        .try_for_each(|line| print(line))
}

/// Lines on machine, line and device; shared with `watch`, like [`work`] and [`figures`].
pub(super) fn machine(status: &Status) -> Vec<String> {
    let link = &status.link;
    let mut lines = vec![format!("machine  {} (layerd {})", status.machine, status.version)];
    let device = link.device.as_deref().unwrap_or("no device yet");
    lines.push(format!("line     {} on {}: {device}", link.state, link.path));
    lines.extend(link.reason.iter().map(|reason| format!("         {reason}")));
    lines.extend(status.stays_lit.iter().map(|warning| format!("LIGHT    {warning}")));
    lines.extend(status.misfit.iter().map(|misfit| format!("MISFIT   {misfit}")));
    lines
}

/// Lines on the jobs at the time `now`: the one that holds the machine, the queue, and the one that ended last.
pub(super) fn work(status: &Status, now: SystemTime) -> Vec<String> {
    let mut lines = match &status.active {
        Some(job) => {
            let mut job = job.clone();
            without_eta(&mut job, status.link.state);
            job_lines(&job, now)
        }
        None => vec!["job      none".into()],
    };
    for job in &status.queue {
        let resin = resin_text(job).map_or_else(String::new, |resin| format!(", {resin}"));
        lines.push(format!("queued   {} {}{resin}", job.id, short_name(&job.name)));
        lines.extend(notes(job).into_iter().map(|note| format!("         {note}")));
    }
    lines.extend(status.last.iter().flat_map(|job| last_lines(job, now)));
    lines
}

/// Lines with figures on memory and line.
pub(super) fn figures(status: &Status) -> Vec<String> {
    let budget = status.budget;
    let mut lines = vec![format!(
        "memory   {} of the budget of {} used, {} at most",
        size_text(budget.used_bytes),
        size_text(budget.limit_bytes),
        size_text(budget.peak_bytes)
    )];
    let line = &status.line;
    lines.push(format!(
        "traffic  {} sent in {}, {} of them again; {}, {}",
        size_text(line.sent_bytes),
        count_text(line.sent_frames, "frame"),
        line.retransmitted_frames,
        count_text(line.bad_frames, "bad frame"),
        count_text(line.reconnects, "reconnect")
    ));
    if let Some(round_trip_ms) = line.round_trip_ms {
        lines.push(format!("         round trip {round_trip_ms:.1} ms"));
    }
    if let Some(busy_share) = line.busy_share {
        lines.push(format!(
            "         while there was data to send, the line was busy {:.1} % of the time",
            100.0 * busy_share
        ));
    }
    if line.unknown_reports > 0 {
        lines.push(format!("         {} of an unknown kind, ignored", count_text(line.unknown_reports, "report")));
    }
    lines.extend(line.hindrance.iter().map(|hindrance| format!("         {hindrance}")));
    lines
}

fn job_lines(job: &JobView, now: SystemTime) -> Vec<String> {
    let mut lines = vec![format!(
        "job      {} {}: {}, recipe {}",
        job.id,
        short_name(&job.name),
        job.state,
        short_name(&job.recipe)
    )];
    lines.extend(progress_lines(job, now).into_iter().map(|line| format!("         {line}")));
    lines.extend(about_ml_text(job).map(|ml| format!("resin    {ml}")));
    if job.late_layers > 0 {
        let late = count_text(job.late_layers.into(), "layer");
        lines.push(format!("late     {late}, {} ms in all", job.late_ms_total));
    }
    lines.extend(notes(job).into_iter().map(|note| format!("         {note}")));
    lines
}

/// Lines on the job that ended last.
fn last_lines(job: &JobView, now: SystemTime) -> Vec<String> {
    let when = job.ended_ms.map_or_else(
        || "at an unknown time".into(),
        |ended_ms| format!("{} ago ({})", age_text(ended_ms), time_text(ended_ms)),
    );
    let mut lines = vec![format!("last     {} {}: {} {when}", job.id, short_name(&job.name), job.state)];
    lines.extend(progress_lines(job, now).into_iter().map(|line| format!("         {line}")));
    lines.extend(resin_text(job).map(|resin| format!("         {resin}")));
    lines.extend(job.reason.iter().map(|reason| format!("         {reason}")));
    lines
}
