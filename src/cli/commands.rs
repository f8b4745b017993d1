//! `layerctl pause | resume | stop | abort [JOB]`. `tests/operator` tests them.

use std::time::Duration;

use anyhow::{anyhow, bail};
use clap::{Args, ValueEnum};
use tokio::time::{Instant, sleep};

use super::client::{Client, ClientError};
use super::patience::BY_HAND;
use super::{block_on, print, print_json};
use crate::api::{InDoubt, JobList, JobView, LinkState, ResumeBody, Status};
use crate::job::JobState;
use crate::text::short_name;

const ACCEPTED: &str = "The command returns when the order is accepted, before it is carried out: `layerctl status` shows how far \
     it is. The command waits up to 30 s for a daemon that does not answer, and says so after 2 s.";

/// How long a device may be disconnected after an order before that is reported: after an abort it begins a new session at once.
const MAX_ABSENCE: Duration = Duration::from_secs(1);
/// How often the daemon is asked whether the device is back.
const ABSENCE_INTERVAL: Duration = Duration::from_millis(100);

/// The end of `pause --help`.
pub(super) fn pause_help() -> String {
    format!(
        "Examples:\n  layerctl pause            the job that holds the machine\n  layerctl pause 7          job 7\n\nThe layer \
         under way ends first; then a plate in resin lifts clear of it, and the job waits for `layerctl \
         resume`. {ACCEPTED}"
    )
}

/// The end of `stop --help`.
pub(super) fn stop_help() -> String {
    format!(
        "Examples:\n  layerctl stop             the job that holds the machine\n  layerctl stop 7           job 7; one that is \
         queued leaves the queue\n\nThe layer under way ends first; then a plate in resin lifts clear of it. A job that was stopped \
         cannot go on. {ACCEPTED}"
    )
}

/// The end of `abort --help`.
pub(super) const ABORT_HELP: &str = "\
Examples:
  layerctl abort            the job that holds the machine; without one the light goes off anyway
  layerctl abort 7          job 7, whichever holds the machine; one that is queued leaves the queue

The light goes off first, in the middle of a layer; then a plate in resin lifts clear of it. Other jobs stay in the queue. A job that \
was aborted cannot go on. The command returns when the order is accepted, and says which job it was: `layerctl status` shows the end. \
It waits up to 60 s for a daemon that does not answer, and says so after 2 s. Do not wait for it then: switch the printer off at the \
mains.";

/// Which job.
#[derive(Debug, Args)]
pub(super) struct JobArgs {
    /// The job's id; without it the job that holds the machine.
    job: Option<String>,
    /// Print the job as one JSON object.
    #[arg(long)]
    json: bool,
}

/// Which job, and what happened to a layer in doubt.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl resume                          the paused job, or the only interrupted one
  layerctl resume 8                        confirms that the plate is empty: job 8, which waits for this, begins
  layerctl resume 7 --in-doubt exposed     the layer in doubt was exposed: go on with the next
  layerctl resume 7 --in-doubt repeat      it was not: expose it again

Look at the machine, and take out what is there, before you confirm that the plate is empty: the plate goes down onto whatever is \
left. A layer is in doubt when its exposure was commanded, but neither the journal nor the device can tell whether it ran. Layers \
are numbered from 0, as their files are.")]
pub(super) struct ResumeArgs {
    /// The job's id; without it the job that is paused or pausing, or the only interrupted one.
    job: Option<String>,
    /// What happened to the layer in doubt.
    #[arg(long, value_name = "WHAT")]
    in_doubt: Option<InDoubtArg>,
    /// Print the job as one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum InDoubtArg {
    /// It was exposed: go on with the next.
    Exposed,
    /// It was not, or not enough: expose it again.
    Repeat,
}

/// `pause`, `stop`, `abort`.
pub(super) fn order(args: JobArgs, order: &str) -> anyhow::Result<()> {
    let client = Client::from_environment();
    block_on(async {
        let job = match (args.job, order) {
            // No look-up first: an abort takes one exchange.
            (Some(id), "abort") => client.order(&id, order).await.map_err(not_aborted)?,
            (None, "abort") => client.abort_active().await.map_err(not_aborted)?,
            (Some(id), _) => client.order(&id, order).await?,
            (None, _) => match client.look_up::<Status>("/v1/status").await?.active {
                Some(job) => client.order(&job.id, order).await?,
                None => bail!("no job holds the machine; `layerctl jobs` lists them"),
            },
        };
        tell(&client, order, &job, args.json).await
    })
}

/// Why an abort was not accepted. If it did not reach the daemon, the text says what to do by hand.
pub(super) fn not_aborted(error: ClientError) -> anyhow::Error {
    match error {
        // There is no such job, or none to abort.
        ClientError::Refused { status: 404 | 409, .. } => error.into(),
        _ => anyhow!("{error}. {BY_HAND}"),
    }
}

/// `resume`.
pub(super) fn resume(args: ResumeArgs) -> anyhow::Result<()> {
    let client = Client::from_environment();
    let body = ResumeBody {
        in_doubt: args.in_doubt.map(|what| match what {
            InDoubtArg::Exposed => InDoubt::Exposed,
            InDoubtArg::Repeat => InDoubt::Repeat,
        }),
    };
    block_on(async {
        let id = match args.job {
            Some(id) => id,
            None => resumable(&client.look_up::<JobList>("/v1/jobs").await?.jobs)?.id.clone(),
        };
        let job = client.resume(&id, body).await?;
        tell(&client, "resume", &job, args.json).await
    })
}

/// The job that is paused or pausing, else the only interrupted one. Never a queued one: the operator must name the job for which
/// they confirm that the plate is empty.
fn resumable(jobs: &[JobView]) -> anyhow::Result<&JobView> {
    if let Some(paused) = jobs.iter().find(|job| matches!(job.state, JobState::Paused | JobState::Pausing)) {
        return Ok(paused);
    }
    let interrupted: Vec<_> = jobs.iter().filter(|job| job.state == JobState::Interrupted).collect();
    match interrupted[..] {
        [job] => Ok(job),
        [] => match jobs.iter().find(|job| job.state.is_active() || job.state == JobState::Queued) {
            Some(job) => {
                let JobView { id, state, .. } = job;
                // The reason of a queued job is what it does: it waits.
                let it = if *state == JobState::Queued { "it " } else { "" };
                let waits = job.reason.as_ref().map_or_else(String::new, |reason| format!(": {it}{reason}"));
                bail!("no job is paused or interrupted; job {id} is {state}{waits}")
            }
            None => bail!("no job is paused or interrupted; `layerctl jobs` lists them"),
        },
        _ => {
            let ids: Vec<_> = interrupted.iter().map(|job| job.id.as_str()).collect();
            bail!("several jobs are interrupted: say which of {}", ids.join(", "))
        }
    }
}

async fn tell(client: &Client, order: &str, job: &JobView, json: bool) -> anyhow::Result<()> {
    if json {
        return print_json(job);
    }
    let mut text = answer(order, job, absence(client, job).await.as_deref());
    if job.state == JobState::Aborting {
        text.push_str("; `layerctl status` shows the end");
    }
    print(&text)?;
    job.warning.as_ref().map_or(Ok(()), |warning| print(&format!("warning: {warning}")))
}

/// Why an order that was accepted may not be carried out yet: the device does not answer, or that is unknown. `None` if the device
/// answers or the job no longer needs it.
pub(super) async fn absence(client: &Client, job: &JobView) -> Option<String> {
    let needs_device = |state: JobState| state.is_active() || state == JobState::Queued;
    let until = Instant::now() + MAX_ABSENCE;
    while needs_device(job.state) {
        let status = match client.status().await {
            Ok(status) => status,
            Err(error) => return Some(format!("whether the device answers is not known ({error})")),
        };
        let is_over = status.last.is_some_and(|last| last.id == job.id);
        if status.link.state == LinkState::Connected || is_over {
            return None;
        }
        if Instant::now() >= until {
            return Some("the device does not answer now".into());
        }
        sleep(ABSENCE_INTERVAL).await;
    }
    None
}

/// The text for an accepted order, which is `pause`, `resume`, `stop` or `abort`; `absence` is that of [`absence`].
pub(super) fn answer(order: &str, job: &JobView, absence: Option<&str>) -> String {
    let JobView { id, state, name, .. } = job;
    // The order may have been given without the job's number, so the answer names the job.
    let named = format!("job {id} ({})", short_name(name));
    if let Some(absence) = absence {
        return match order {
            // What to do comes first: there may be little room.
            "abort" => format!("{BY_HAND}: {absence}. It will abort {named} as soon as it answers"),
            _ => {
                format!(
                    "the order to {order} job {id} is accepted, and will be carried out when the device answers: {absence}"
                )
            }
        };
    }
    match (order, state) {
        ("pause", JobState::Pausing) => {
            format!("job {id} pauses after the layer under way; then a plate in resin lifts clear of it")
        }
        ("pause", JobState::Checking) => format!("job {id} is being checked; then it pauses before its first layer"),
        ("resume", JobState::Queued) if job.started_ms.is_none() => {
            format!("job {id} begins: the plate is confirmed to be empty")
        }
        ("resume", JobState::Queued | JobState::Checking | JobState::Printing) => format!("job {id} goes on"),
        ("stop", JobState::Stopping) => {
            format!("{named} stops after the layer under way; then a plate in resin lifts clear of it")
        }
        ("abort", JobState::Aborting) => {
            format!("{named} is being aborted: the light goes off first, then a plate in resin lifts clear of it")
        }
        ("stop" | "abort", _) => format!("{named} is {state}"),
        _ => format!("job {id} is {state}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(id: &str, state: JobState) -> JobView {
        let text = format!(
            r#"{{"id": "{id}", "name": "a", "state": "{state}", "recipe": "r", "layers_done": 812, "layers_total": 3000,
            "layer": null, "eta_s": null, "late_layers": 0, "late_ms_total": 0, "submitted_ms": 1, "started_ms": null,
            "ended_ms": null, "reason": null, "in_doubt": null}}"#
        );
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn without_a_number_resume_means_the_job_that_can_go_on() {
        let pick = |states: &[JobState]| {
            let jobs: Vec<_> = states.iter().zip(1..).map(|(state, id)| job(&format!("{id}"), *state)).collect();
            resumable(&jobs).map(|job| job.id.clone()).map_err(|error| error.to_string())
        };
        use JobState::{Completed, Interrupted, Paused, Pausing, Printing, Queued};
        assert_eq!(pick(&[Completed, Pausing, Queued]), Ok("2".into()));
        assert_eq!(pick(&[Completed, Queued, Paused]), Ok("3".into()));
        assert_eq!(pick(&[Interrupted, Queued]), Ok("1".into()));
        assert!(pick(&[Interrupted, Interrupted]).unwrap_err().contains("1, 2"));
        assert!(pick(&[Completed, Printing]).unwrap_err().contains("job 2 is printing"));
        assert!(pick(&[Completed]).unwrap_err().contains("layerctl jobs"));
    }

    #[test]
    fn an_answer_says_what_happens_next() {
        let mut queued = job("3", JobState::Queued);
        assert!(answer("resume", &queued, None).contains("begins"));
        queued.started_ms = Some(1);
        assert!(answer("resume", &queued, None).contains("goes on"));
        assert!(answer("pause", &job("3", JobState::Pausing), None).contains("after the layer under way"));
        assert!(answer("abort", &job("3", JobState::Aborting), None).contains("light goes off first"));
        assert_eq!(answer("stop", &job("3", JobState::Stopped), None), "job 3 (a) is stopped");
    }

    #[test]
    fn an_answer_promises_nothing_of_a_device_that_does_not_answer() {
        let told = |order, state| answer(order, &job("3", state), Some("the device does not answer now"));
        let abort = told("abort", JobState::Aborting);
        assert!(
            abort.starts_with(BY_HAND) && abort.contains("does not answer now. It will abort job 3 (a)"),
            "{abort}"
        );
        assert!(!abort.contains("light goes off first"), "{abort}");
        for (order, state) in
            [("pause", JobState::Pausing), ("stop", JobState::Stopping), ("resume", JobState::Printing)]
        {
            let told = told(order, state);
            assert!(told.contains("is accepted, and will be carried out when the device answers"), "{told}");
        }
    }
}
