//! `layerctl pause | resume | stop | abort [JOB]`.

use anyhow::bail;
use clap::{Args, ValueEnum};

use super::client::Client;
use super::{block_on, print, print_json};
use crate::daemon::api::{InDoubt, JobView, ResumeBody};
use crate::job::JobState;

/// Which job.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl pause            the job that is printing
  layerctl stop 7           job 7, after the layer under way
  layerctl abort            now: the light goes off first, then the plate lifts")]
pub(super) struct JobArgs {
    /// The job's id; without it the job that holds the machine.
    job: Option<String>,
    /// Print the job as one JSON object.
    #[arg(long)]
    json: bool,
}

/// Which job, and what is known of a layer in doubt.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl resume                          the paused job, or the only interrupted one
  layerctl resume 7 --in-doubt exposed     the layer in doubt was exposed: go on with the next
  layerctl resume 7 --in-doubt repeat      it was not: expose it again

A layer is in doubt when its exposure was commanded but neither the journal nor the device can tell whether it ran.")]
pub(super) struct ResumeArgs {
    /// The job's id; without it the paused job, or the only interrupted one.
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
    let job = block_on(async {
        Ok(match (args.job, order) {
            (Some(id), _) => client.order(&id, order).await?,
            // No look-up first: an abort takes one exchange.
            (None, "abort") => client.abort_active().await?,
            (None, _) => match client.status().await?.active {
                Some(job) => client.order(&job.id, order).await?,
                None => bail!("no job holds the machine; `layerctl jobs` lists them"),
            },
        })
    })?;
    tell(&job, args.json)
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
    let job = block_on(async {
        let id = match args.job {
            Some(id) => id,
            None => resumable(&client.jobs().await?)?.id.clone(),
        };
        Ok(client.resume(&id, body).await?)
    })?;
    tell(&job, args.json)
}

/// The paused job, else the only interrupted one.
fn resumable(jobs: &[JobView]) -> anyhow::Result<&JobView> {
    if let Some(paused) = jobs.iter().find(|job| job.state == JobState::Paused) {
        return Ok(paused);
    }
    let interrupted: Vec<_> = jobs.iter().filter(|job| job.state == JobState::Interrupted).collect();
    match interrupted[..] {
        [job] => Ok(job),
        [] => bail!("no job is paused or interrupted; `layerctl jobs` lists them and says what each one waits for"),
        _ => {
            let ids: Vec<_> = interrupted.iter().map(|job| job.id.as_str()).collect();
            bail!("several jobs are interrupted: say which of {}", ids.join(", "))
        }
    }
}

fn tell(job: &JobView, json: bool) -> anyhow::Result<()> {
    if json {
        return print_json(job);
    }
    print(&format!("job {} is {}", job.id, job.state))?;
    job.warning.as_ref().map_or(Ok(()), |warning| print(&format!("warning: {warning}")))
}
