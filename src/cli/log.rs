//! `layerctl log`: what happened to a job, from its journal, in plain words. `tests/operator/records.rs` shows it.

mod story;

use clap::Args;

use self::story::Story;
use super::client::Client;
use super::{Ending, block_on, print, print_json};

/// Tell what happened to a job: its layers, pauses, doubts, orders and its end.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  layerctl log 7                a line for each thing that happened; layers exposed one after another share a line
  layerctl log 7 --all          two lines for each layer: when its exposure was commanded, and when the device confirmed it
  layerctl log 7 --json | jq -r 'select(.record == \"in_doubt\") | .why'

It works for every job that `layerctl jobs` lists, during the print, too. Times are local ones. Orders to stop and abort are in it; \
the daemon's log says who gave them (journalctl -u layerd). If the job's journal is damaged, what can be read is shown, \
then what is wrong, and the exit code is 1.")]
pub(super) struct LogArgs {
    /// The job's id.
    job: String,
    /// Show each layer on lines of its own.
    #[arg(long)]
    all: bool,
    /// Print each record as one JSON object on a line of its own.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &LogArgs) -> anyhow::Result<Ending> {
    block_on(async {
        let mut log = Client::from_environment().log(&args.job).await?;
        let mut story = Story::new(args.all);
        let tell = |lines: Vec<String>| lines.iter().try_for_each(|line| print(line));
        while let Some(entry) = log.next().await? {
            if args.json {
                print_json(&entry)?;
            } else {
                tell(story.continued(&entry))?;
            }
        }
        tell(story.ended())?;
        let Some(problem) = log.problem() else { return Ok(Ending::Done) };
        super::eprint(&format!("error: {problem}"));
        Ok(Ending::Failed)
    })
}
