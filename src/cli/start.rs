//! `layerctl start`: hands a build file to the daemon and, if asked, waits for the end of the print.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use indicatif::ProgressBar;

use super::client::{Client, ClientError, Events, NewJob};
use super::{Ending, block_on, duration_text, print, print_json, progress_bar};
use crate::config::{ConfigText, Folder, Recipe, find};
use crate::daemon::api::{Event, JobView};
use crate::job::JobState;

/// How long a daemon that went away is waited for: systemd starts it again within seconds.
const RECONNECT: Duration = Duration::from_secs(10);
const BAR: &str = "{msg:10} [{wide_bar}] {pos}/{len} {prefix}";

/// Give a build file to the daemon as a new job.
#[derive(Debug, Args)]
#[command(after_help = super::with_names("\
Examples:
  layerctl start part.layerd                       prints the job's id and returns
  layerctl start part.layerd --recipe fine --wait  shows progress until the print has ended

Exit codes with --wait: 0 completed, 1 failed, 3 aborted or stopped, 4 interrupted."))]
pub(super) struct StartArgs {
    /// The build file, as `layerctl pack` writes it.
    file: PathBuf,
    /// Recipe, a name or a path; without it the daemon's default.
    #[arg(long, value_name = "NAME|PATH")]
    recipe: Option<String>,
    /// Wait for the end of the print.
    #[arg(long)]
    wait: bool,
    /// Print the job as one JSON object; with --wait as it ended.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: StartArgs) -> anyhow::Result<Ending> {
    let recipe = args.recipe.as_deref().map(read_recipe).transpose()?;
    let name = args.file.file_name().context("the build file has no name")?.to_string_lossy().into_owned();
    let new = NewJob { part: args.file, name, recipe };
    block_on(async {
        let client = Client::from_environment();
        // Listening before submitting: no event of the job is missed.
        let events = if args.wait { Some(client.events().await?) } else { None };
        let bar = progress_bar(BAR);
        bar.set_message("sending");
        let job = client
            .submit(&new, |sent, total| {
                bar.set_length(total);
                bar.set_position(sent);
            })
            .await?;
        bar.finish_and_clear();
        let Some(events) = events else {
            return tell(&job, args.json).map(|()| Ending::Done);
        };
        if !args.json {
            print(&job.id)?;
        }
        let (job, ending) = wait(&client, job, events).await?;
        if args.json {
            print_json(&job)?;
        }
        Ok(ending)
    })
}

fn tell(job: &JobView, json: bool) -> anyhow::Result<()> {
    if json { print_json(job) } else { print(&job.id) }
}

/// Name and text of a recipe, checked here already: a typing error is told before anything is sent.
fn read_recipe(recipe: &str) -> anyhow::Result<(String, String)> {
    let ConfigText { path, text } = find(Folder::Recipes, recipe)?;
    let checked = Recipe::parse(&path, &text)?;
    Ok((checked.name, text))
}

/// Follows a job until nothing happens to it any more; tells how it ended on stderr.
pub(super) async fn wait(client: &Client, mut job: JobView, mut events: Events) -> anyhow::Result<(JobView, Ending)> {
    let bar = progress_bar(BAR);
    let mut told = None;
    loop {
        show(&bar, &job);
        if job.state == JobState::Queued && job.reason != told {
            told.clone_from(&job.reason);
            bar.suspend(|| told.iter().for_each(|reason| super::eprint(&format!("job {} {reason}", job.id))));
        }
        if let Some(ending) = ending(job.state) {
            bar.finish_and_clear();
            summarise(&job);
            return Ok((job, ending));
        }
        match events.next().await {
            Ok(Some(Event::Job(changed))) if changed.id == job.id => job = *changed,
            Ok(Some(Event::Status(_) | Event::Lagged { .. })) => job = client.job(&job.id).await?,
            Ok(Some(Event::Layer(exposed))) if exposed.job == job.id => {
                job.layers_done = job.layers_done.max(exposed.layer.saturating_add(1));
            }
            Ok(Some(Event::Notice { text })) => bar.suspend(|| super::eprint(&text)),
            Ok(Some(_)) => {}
            Ok(None) | Err(_) => {
                let Some(again) = reconnect(client).await? else {
                    bar.finish_and_clear();
                    eprintln!("the daemon is gone; once it runs again: layerctl resume {}", job.id);
                    return Ok((job, Ending::Interrupted));
                };
                events = again;
            }
        }
    }
}

/// Waits for a daemon that went away; `None` if it does not come back.
async fn reconnect(client: &Client) -> anyhow::Result<Option<Events>> {
    let began = tokio::time::Instant::now();
    while began.elapsed() < RECONNECT {
        match client.events().await {
            Ok(events) => return Ok(Some(events)),
            Err(ClientError::NoDaemon { .. } | ClientError::Broken(_)) => {}
            Err(error) => return Err(error.into()),
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    Ok(None)
}

fn ending(state: JobState) -> Option<Ending> {
    match state {
        JobState::Completed => Some(Ending::Done),
        JobState::Failed => Some(Ending::Failed),
        JobState::Stopped | JobState::Aborted => Some(Ending::Aborted),
        JobState::Interrupted => Some(Ending::Interrupted),
        _ => None,
    }
}

fn show(bar: &ProgressBar, job: &JobView) {
    bar.set_length(u64::from(job.layers_total));
    bar.set_position(u64::from(job.layers_done));
    bar.set_message(job.state.name());
    bar.set_prefix(job.eta_s.map(duration_text).unwrap_or_default());
}

fn summarise(job: &JobView) {
    let reason = job.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
    let JobView { id, state, layers_done, layers_total, .. } = job;
    super::eprint(&format!("job {id} {state} after {layers_done} of {layers_total} layers{reason}"));
    if job.late_layers > 0 {
        eprintln!("{} layers were late, {} ms in all", job.late_layers, job.late_ms_total);
    }
    if job.state == JobState::Interrupted {
        eprintln!("it can go on: layerctl resume {}", job.id);
    }
}
