//! `layerctl start`: hands a build file to the daemon and, if asked, waits for the end of the print. `tests/operator` tests it.

use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use anyhow::Context;
use clap::{ArgGroup, Args};
use indicatif::ProgressBar;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::{Instant, timeout};

use super::client::{Client, ClientError, Events, NewJob};
use super::jobs::doubt_commands;
use super::progress::{duration_text, progress_lines, without_eta};
use super::{Ending, block_on, print, print_json, progress_bar};
use crate::api::{Event, JobView, LinkState, LinkView, Status};
use crate::buildfile::BuildFile;
use crate::config::{ConfigText, Folder, Recipe, find};
use crate::job::JobState;
use crate::text::count_text;
use crate::text::layer_text;

/// How long to wait for a daemon that went away: systemd starts it again within seconds.
const RECONNECT: Duration = Duration::from_secs(10);
/// How often progress is written as a line where no bar can be drawn.
const LINE_INTERVAL: Duration = Duration::from_secs(60);
pub(super) const BAR: &str = "{msg:10} [{wide_bar}] {pos} of {len} {prefix}";

/// Print a build file, or the part of an earlier job again: give it to the daemon as a new job.
#[derive(Debug, Args)]
// Without either, clap names both.
#[command(group(ArgGroup::new("part").required(true).args(["file", "again"])))]
#[command(after_help = super::with_names("\
Examples:
  layerctl start part.layerd                       prints the job's id and returns
  layerctl start part.layerd --recipe fine --wait  shows progress until the print has ended
  layerctl start --again 7                         prints the part of job 7 once more, with the recipe of job 7
  layerctl start --again 7 --recipe fine           the same with another recipe

--again needs no file: the part is still in the daemon's spool, which keeps those of the newest 10 jobs that are over, however they \
ended. The new job is checked as any other.

On stderr it says what the job waits for: other jobs, your confirmation that the plate is empty, a device. A job that is started while the machine is idle begins at once: take the last part \
off and look at the plate first. With --wait it shows \
progress there, too: a bar on a terminal, elsewhere a line a minute and one whenever the job's state changes. Ctrl-C ends the \
command, and the print goes on.

Exit codes with --wait: 0 completed, 1 failed, 3 aborted or stopped, 4 interrupted or the daemon is gone, 130 ended by Ctrl-C."))]
pub(super) struct StartArgs {
    /// The build file, as `layerctl pack` writes it.
    file: Option<PathBuf>,
    /// Print the part of this job, which is over, once more.
    #[arg(long, value_name = "JOB")]
    again: Option<String>,
    /// Recipe, a name or a path; without it the daemon's default, or with --again that of the earlier job.
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
    let source = match args.again {
        Some(job) => Source::Again { job, recipe },
        None => {
            let part = args.file.context("no build file is named")?;
            let name = part.file_name().context("the build file has no name")?.to_string_lossy().into_owned();
            // Finds a wrong or truncated file before gigabytes of it are sent.
            BuildFile::open(&part)?;
            Source::File(NewJob { part, name, recipe })
        }
    };
    let bar = progress_bar(BAR);
    let client = Client::from_environment().telling({
        let bar = bar.clone();
        move |text| bar.suspend(|| super::eprint(text))
    });
    block_on(async {
        let mut interrupt = signal(SignalKind::interrupt()).context("cannot wait for SIGINT")?;
        let submitted = tokio::select! {
            submitted = submit(&client, &source, args.wait, &bar) => submitted?,
            _ = interrupt.recv() => {
                bar.finish_and_clear();
                super::eprint("ended by Ctrl-C while the part was sent or checked; `layerctl jobs` tells whether the daemon took it");
                return Ok(Ending::Signal);
            }
        };
        let (job, events) = submitted;
        if !(args.json && args.wait) {
            tell(&job, args.json)?;
        }
        let Some(events) = events else {
            tell_waits(&client, &job).await;
            return Ok(Ending::Done);
        };
        let waited = tokio::select! {
            waited = async {
                tell_device(&client, &job).await;
                wait(&client, job.clone(), events, &bar).await
            } => waited?,
            _ = interrupt.recv() => {
                bar.finish_and_clear();
                let id = &job.id;
                super::eprint(&format!(
                    "job {id} goes on without this command. Follow it with `layerctl watch`; end it with `layerctl stop {id}` or, \
                     at once, `layerctl abort {id}`"
                ));
                return Ok(Ending::Signal);
            }
        };
        let (job, ending) = waited;
        if args.json {
            print_json(&job)?;
        }
        Ok(ending)
    })
}

/// What to print.
enum Source {
    /// A build file.
    File(NewJob),
    /// The part of a job that is over, with a recipe of another name and text.
    Again { job: String, recipe: Option<(String, String)> },
}

/// Submits the job; returns it, and its events if `wait`.
async fn submit(
    client: &Client,
    source: &Source,
    wait: bool,
    bar: &ProgressBar,
) -> anyhow::Result<(JobView, Option<Events>)> {
    // Subscribes before submitting, so that no event of the job is missed.
    let events = if wait { Some(client.events().await?) } else { None };
    bar.set_message("sending");
    let progress = |sent, total| {
        bar.set_length(total);
        bar.set_position(sent);
    };
    let job = match source {
        Source::File(new) => client.submit(new, progress).await,
        Source::Again { job, recipe } => client.again(job, recipe.as_ref()).await,
    };
    bar.finish_and_clear();
    Ok((job.map_err(not_answered)?, events))
}

/// Why a job was not submitted. If the connection broke, the daemon may have taken the job before.
fn not_answered(error: ClientError) -> anyhow::Error {
    match error {
        ClientError::Broken(_) => anyhow::anyhow!(
            "{error}. It may have taken the job all the same: look at `layerctl jobs` before you start the part again"
        ),
        error => error.into(),
    }
}

/// Says on stderr what a new job waits for: stdout holds only the job's id.
async fn tell_waits(client: &Client, job: &JobView) {
    if let Some(reason) = &job.reason {
        super::eprint(&format!("job {} {reason}", job.id));
    }
    tell_device(client, job).await;
}

/// Says what the plate is taken to be, and if no device answers. If the device did not fit, the daemon would have refused the job.
async fn tell_device(client: &Client, job: &JobView) {
    if let Some(text) = &job.warning {
        super::eprint(text);
    }
    match client.status().await.map(|status| status.link) {
        Ok(LinkView { state: LinkState::Connected, .. }) => {}
        Ok(LinkView { path, reason, .. }) => {
            let reason = reason.unwrap_or_else(|| format!("{path}: switch the device on"));
            super::eprint(&format!(
                "no device answers yet: {reason}. Job {} waits a minute for one once its turn comes, then fails",
                job.id
            ));
        }
        // Not an error of the command: the daemon has the job, and its id was printed.
        Err(error) => {
            super::eprint(&format!("job {} was taken, but whether a device is there is not known: {error}", job.id));
        }
    }
}

fn tell(job: &JobView, json: bool) -> anyhow::Result<()> {
    if json { print_json(job) } else { print(&job.id) }
}

/// Name and text of a recipe, checked here so that an error is reported before anything is sent.
fn read_recipe(recipe: &str) -> anyhow::Result<(String, String)> {
    let ConfigText { path, text } = find(Folder::Recipes, recipe)?;
    let checked = Recipe::parse(&path, &text)?;
    Ok((checked.name().into(), text))
}

/// Follows a job to its end, and reports that on stderr. If `bar` is hidden, writes lines of progress instead.
pub(super) async fn wait(
    client: &Client,
    job: JobView,
    mut events: Events,
    bar: &ProgressBar,
) -> anyhow::Result<(JobView, Ending)> {
    bar.reset();
    let said = job.warning.clone();
    let mut followed = Followed { job, said, link: LinkState::Connected, is_back: false };
    let mut told = String::new();
    let mut lines = Lines::default();
    loop {
        let Followed { job, link, .. } = &mut followed;
        without_eta(job, *link);
        show(bar, job);
        if let Some(ending) = ending(job.state) {
            bar.finish_and_clear();
            summarise(job);
            return Ok((followed.job, ending));
        }
        let waits_for = job.reason.as_ref().filter(|_| job.state == JobState::Queued);
        if bar.is_hidden() && lines.is_due(job, Instant::now()) {
            super::eprint(&line(job));
            waits_for.inspect(|reason| told.clone_from(reason));
        } else if let Some(reason) = waits_for.filter(|reason| **reason != told) {
            // The reason may vanish for a moment and come back; it is told only once.
            bar.suspend(|| super::eprint(&format!("job {} {reason}", job.id)));
            told.clone_from(reason);
        }
        match timeout(LINE_INTERVAL, events.next()).await {
            Err(_) => {}
            Ok(Ok(Some(event))) => followed.take(client, event, bar).await?,
            Ok(Ok(None) | Err(_)) => {
                bar.suspend(|| super::eprint("the daemon has gone; waiting up to 10 s for it to come back"));
                let Some(again) = reconnect(client).await? else {
                    bar.finish_and_clear();
                    super::eprint(&format!(
                        "the daemon does not come back. Once it runs again, `layerctl status` tells how job {0} stands; an \
                         interrupted job goes on with `layerctl resume {0}`",
                        job.id
                    ));
                    return Ok((followed.job, Ending::Interrupted));
                };
                (events, followed.is_back) = (again, true);
            }
        }
    }
}

/// The job that [`wait`] follows, as the events so far describe it.
struct Followed {
    job: JobView,
    /// The notice that the answer to `start` contained already.
    said: Option<String>,
    link: LinkState,
    /// The daemon went away and came back.
    is_back: bool,
}

impl Followed {
    /// Takes in an event; prints it if it is a notice.
    async fn take(&mut self, client: &Client, event: Event, bar: &ProgressBar) -> anyhow::Result<()> {
        match event {
            Event::Job(changed) if changed.id == self.job.id => self.job = *changed,
            // The job of this very moment: what `client.job` answers may be newer than the next events, which would then go back.
            Event::Status(status) => {
                self.link = status.link.state;
                let Status { active, queue, last, .. } = *status;
                match active.into_iter().chain(queue).chain(last).find(|found| found.id == self.job.id) {
                    Some(found) => self.job = found,
                    // It ended while the daemon was away, and another one after it.
                    None if self.is_back => self.job = client.job(&self.job.id).await?,
                    // It was submitted after this moment.
                    None => {}
                }
            }
            Event::Lagged { .. } => self.job = client.job(&self.job.id).await?,
            Event::Link(changed) => self.link = changed.state,
            Event::Layer(exposed) if exposed.job == self.job.id => {
                self.job.layers_done = self.job.layers_done.max(exposed.layer.saturating_add(1));
            }
            Event::Notice { text } if self.said.as_ref() != Some(&text) => bar.suspend(|| super::eprint(&text)),
            // Of other jobs, or said already.
            Event::Job(_) | Event::Layer(_) | Event::Notice { .. } => {}
        }
        Ok(())
    }
}

/// Decides when a line of progress is due.
#[derive(Debug, Default)]
struct Lines {
    last: Option<(JobState, Instant)>,
}

impl Lines {
    /// Whether a line is due now: the job's state changed, or the last line is [`LINE_INTERVAL`] old.
    fn is_due(&mut self, job: &JobView, now: Instant) -> bool {
        let is_due = self.last.is_none_or(|(state, at)| state != job.state || now >= at + LINE_INTERVAL);
        if is_due {
            self.last = Some((job.state, now));
        }
        is_due
    }
}

fn line(job: &JobView) -> String {
    let reason = job.reason.as_ref().map_or_else(String::new, |reason| format!("; {reason}"));
    format!("job {} {}: {}{reason}", job.id, job.state, progress_lines(job, SystemTime::now()).join(", "))
}

/// Subscribes again to a daemon that went away; `None` if it does not come back.
async fn reconnect(client: &Client) -> anyhow::Result<Option<Events>> {
    let began = Instant::now();
    while began.elapsed() < RECONNECT {
        match client.events().await {
            Ok(events) => return Ok(Some(events)),
            Err(ClientError::NoDaemon { .. } | ClientError::Broken(_) | ClientError::Silent { .. }) => {}
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
    let eta = job.eta_s.map_or_else(String::new, |eta| format!(", {} to go", duration_text(eta)));
    bar.set_prefix(format!("layers done{eta}"));
}

fn summarise(job: &JobView) {
    let reason = job.reason.as_ref().map_or_else(String::new, |reason| format!("; {reason}"));
    let progress = progress_lines(job, SystemTime::now()).join(", ");
    super::eprint(&format!("job {} {}: {progress}{reason}", job.id, job.state));
    if job.late_layers > 0 {
        super::eprint(&format!(
            "late: {}, {} ms in all",
            count_text(job.late_layers.into(), "layer"),
            job.late_ms_total
        ));
    }
    if job.state == JobState::Interrupted {
        super::eprint(&remedy(job));
    }
}

/// How an interrupted job goes on. A layer in doubt needs the operator's choice.
fn remedy(job: &JobView) -> String {
    let id = &job.id;
    match job.in_doubt {
        None => format!("it can go on: `layerctl resume {id}`"),
        Some(layer) => {
            let layer = layer_text(layer, job.material.as_deref());
            format!("look whether {layer} was exposed; then {}", doubt_commands(id))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interrupted_job_names_a_command_that_is_taken() {
        let text = r#"{"id": "18", "name": "a", "state": "interrupted", "recipe": "r", "layers_done": 8, "layers_total": 30,
            "layer": null, "eta_s": null, "late_layers": 0, "late_ms_total": 0, "submitted_ms": 1, "started_ms": null,
            "ended_ms": null, "reason": null, "in_doubt": null}"#;
        let mut job: JobView = serde_json::from_str(text).unwrap();
        assert_eq!(remedy(&job), "it can go on: `layerctl resume 18`");
        job.in_doubt = Some(8);
        let told = remedy(&job);
        for command in ["`layerctl resume 18 --in-doubt exposed`", "`layerctl resume 18 --in-doubt repeat`"] {
            assert!(told.contains(command), "{told}");
        }
        assert!(told.contains("layer 8") && !told.contains("`layerctl resume 18`"), "{told}");
    }

    #[test]
    fn a_line_is_due_once_a_minute_and_when_the_state_changes() {
        let text = r#"{"id": "8", "name": "a", "state": "printing", "recipe": "r", "layers_done": 812, "layers_total": 3000,
            "layer": 812, "eta_s": 95, "late_layers": 0, "late_ms_total": 0, "submitted_ms": 1, "started_ms": null,
            "ended_ms": null, "reason": "layer 812 is late", "in_doubt": null}"#;
        let mut job: JobView = serde_json::from_str(text).unwrap();
        let told = line(&job);
        assert!(
            told.starts_with("job 8 printing: 812 of 3000 layers done (27 %), 1 min 35 s to go, until about 20"),
            "{told}"
        );
        assert!(told.ends_with(" UTC; layer 812 is late"), "{told}");
        let (mut lines, began) = (Lines::default(), Instant::now());
        let due: Vec<bool> = [0, 1, 59, 60, 61, 120].map(|s| lines.is_due(&job, began + Duration::from_secs(s))).into();
        assert_eq!(due, [true, false, false, true, false, true]);
        job.state = JobState::Pausing;
        assert!(lines.is_due(&job, began + Duration::from_secs(121)));
    }
}
