//! `layerctl`: what an operator types. Exit codes: 0 done, 1 failed, 2 wrong usage; `start --wait`: 3 aborted or stopped,
//! 4 interrupted and resumable; 130 `start` was ended by Ctrl-C.
//!
//! Layers have one numbering, for files, protocol and people: "layer 812" is the one of `layer_000812.png`, the first is layer 0.
//! Progress is a count, "812 of 3000 layers done": layers 0 to 811, so that layer 812 is next.

pub mod check;
pub mod client;
mod commands;
mod demo;
mod device;
pub mod generate;
pub mod info;
mod jobs;
pub mod pack;
mod patience;
mod raise;
mod remove;
pub mod simulate;
pub mod slice;
mod start;
mod status;
mod watch;

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::buildfile::PackError;
use crate::config::{ConfigText, Folder, Machine, find};
use crate::daemon::api::JobView;
pub use crate::text::eprint;
use crate::text::{is_hidden, plain};

/// Prints implicit geometry just in time: pack a part, check it, start it, watch it.
#[derive(Debug, Parser)]
#[command(name = "layerctl", version, propagate_version = true, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
From a part to a print:
  layerctl pack lattice.3mf -o lattice.layerd
  layerctl check lattice.layerd --machine sim-dlp --recipe default
  layerctl start lattice.layerd --recipe default --wait
  layerctl watch

The daemon is asked through its control socket, $LAYERD_SOCKET or /run/layerd/control.sock. Where it does not answer, commands say \
so after 2 s; questions are given up after 5 s, orders after 30 s, an abort after 60 s.

\"Layer 812\" is always the layer of the file layer_000812.png: the first is layer 0. \"812 of 3000 layers done\" is a count: \
layers 0 to 811 are done, and layer 812 is next.

Exit codes: 0 done, 1 failed, 2 wrong usage; start --wait: 3 aborted or stopped, 4 interrupted (resumable), 130 ended by Ctrl-C.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Turn 3MF or edge text into a build file.
    Pack(pack::PackArgs),
    /// Make a synthetic lattice.
    Generate(generate::GenerateArgs),
    /// Tell what is in a build file.
    Info(info::InfoArgs),
    /// Preflight: does a part fit volume, budget and line.
    Check(check::CheckArgs),
    /// Write the very layers a print would send.
    Slice(slice::SliceArgs),
    /// Be a device on a pseudo-terminal.
    Simulate(simulate::SimulateArgs),
    /// The daemon itself, so that `demo` needs no second program.
    #[command(hide = true)]
    Daemon {
        /// The daemon's configuration file.
        #[arg(long)]
        config: std::path::PathBuf,
    },
    /// Give a build file to the daemon as a new job; prints its id.
    Start(start::StartArgs),
    /// Everything at a glance: line, job, queue, the job that ended last, budget.
    Status(status::StatusArgs),
    /// Follow the print in the terminal; keys pause, resume, stop and abort it.
    Watch(watch::WatchArgs),
    /// List the jobs the daemon remembers, the oldest first.
    Jobs(jobs::JobsArgs),
    /// Show what the device is and does.
    Device(device::DeviceArgs),
    /// End the layer under way, lift the plate clear and wait.
    #[command(after_help = commands::pause_help())]
    Pause(commands::JobArgs),
    /// Let a paused or interrupted job go on, or one begin that waits for a clear plate.
    Resume(commands::ResumeArgs),
    /// End the job after the layer under way.
    #[command(after_help = commands::stop_help())]
    Stop(commands::JobArgs),
    /// End the job now: light off first, then lift.
    #[command(after_help = commands::ABORT_HELP)]
    Abort(commands::JobArgs),
    /// Lift the plate clear of the resin while no job runs.
    Raise(raise::RaiseArgs),
    /// Delete finished jobs, their parts and their records.
    Remove(remove::RemoveArgs),
    /// Print a lattice on a simulated printer: everything in one go.
    Demo(demo::DemoArgs),
}

/// How a command ended, beyond "failed" (an error, exit code 1) and "wrong usage" (clap, exit code 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ending {
    Done,
    Failed,
    Aborted,
    Interrupted,
    /// By Ctrl-C, before what was waited for had come.
    Signal,
}

impl From<Ending> for ExitCode {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Done => Self::SUCCESS,
            Ending::Failed => Self::from(1),
            Ending::Aborted => Self::from(3),
            Ending::Interrupted => Self::from(4),
            // As shells count: 128 and the signal's number.
            Ending::Signal => Self::from(130),
        }
    }
}

/// Parses the command line and carries it out; errors go to stderr with their causes.
pub fn run() -> ExitCode {
    let arguments = Arguments::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit());
    match dispatch(arguments.command) {
        Ok(ending) => ending.into(),
        Err(error) => {
            report(&error);
            // An option's value is wrong usage, whoever finds it.
            let is_usage = matches!(error.downcast_ref(), Some(PackError::Option(_)));
            ExitCode::from(if is_usage { 2 } else { 1 })
        }
    }
}

/// The command line. `-5` is a value wherever one may stand: what is wrong with it is said by whatever takes it, not by a tip on
/// the use of `--`.
fn command() -> clap::Command {
    let values = |argument: clap::Arg| match argument.get_action().takes_values() {
        true => argument.allow_negative_numbers(true),
        false => argument,
    };
    Arguments::command().mut_subcommands(|command| command.mut_args(values))
}

fn dispatch(command: Command) -> anyhow::Result<Ending> {
    match command {
        Command::Pack(args) => pack::run(args).map(done),
        Command::Generate(args) => generate::run(args).map(done),
        Command::Info(args) => info::run(args).map(done),
        Command::Check(args) => check::run(args).map(done),
        Command::Slice(args) => slice::run(args).map(done),
        Command::Simulate(args) => simulate::run(args).map(done),
        Command::Daemon { config } => crate::daemon::run(&config).map(done),
        Command::Start(args) => start::run(args),
        Command::Status(args) => status::run(&args).map(done),
        Command::Watch(args) => watch::run(&args).map(done),
        Command::Jobs(args) => jobs::run(&args).map(done),
        Command::Device(args) => device::run(&args).map(done),
        Command::Pause(args) => commands::order(args, "pause").map(done),
        Command::Resume(args) => commands::resume(args).map(done),
        Command::Stop(args) => commands::order(args, "stop").map(done),
        Command::Abort(args) => commands::order(args, "abort").map(done),
        Command::Raise(args) => raise::run(&args).map(done),
        Command::Remove(args) => remove::run(args),
        Command::Demo(args) => demo::run(&args).map(done),
    }
}

fn done((): ()) -> Ending {
    Ending::Done
}

/// `error: …` and each cause that its text does not already contain.
pub fn report(error: &anyhow::Error) {
    let mut told = error.to_string();
    eprint(&format!("error: {told}"));
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !told.contains(&cause) {
            eprint(&format!("  because: {cause}"));
            told.push_str(&cause);
        }
    }
}

/// Runs a conversation with the daemon on this thread.
fn block_on<T>(conversation: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(conversation)
}

/// One JSON object on stdout, nothing else.
fn print_json(value: &impl serde::Serialize) -> anyhow::Result<()> {
    let mut line = String::new();
    for character in serde_json::to_string(value)?.chars() {
        // JSON lets these stand as they are; a terminal would obey or hide them.
        if is_hidden(character) {
            let mut units = [0; 2];
            character.encode_utf16(&mut units).iter().for_each(|unit| line.push_str(&format!("\\u{unit:04x}")));
        } else {
            line.push(character);
        }
    }
    write_line(&line)
}

/// A text on stdout, [`plain`].
fn print(text: &str) -> anyhow::Result<()> {
    write_line(&plain(text))
}

/// A closed pipe is an error, not a panic.
fn write_line(text: &str) -> anyhow::Result<()> {
    use std::io::Write;
    writeln!(std::io::stdout().lock(), "{text}").map_err(|error| anyhow::anyhow!("cannot write to stdout: {error}"))
}

/// Help that ends with where names of machines and recipes are looked for.
fn with_names(help: &str) -> String {
    format!(
        "{help}\n\nA machine or recipe is a path or a name: of a file in machines/ or recipes/ below $LAYERD_CONFIG_DIR, \
         /etc/layerd or config, or of one built in."
    )
}

/// The machine of a path or a name.
fn find_machine(machine: &str) -> anyhow::Result<Machine> {
    let ConfigText { path, text } = find(Folder::Machines, machine)?;
    Ok(Machine::parse(&path, &text)?)
}

/// A bar on stderr, of an indicatif template; invisible where that is no terminal.
fn progress_bar(template: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(5));
    bar.with_style(ProgressStyle::with_template(template).expect("our own templates are well-formed"))
}

/// Bytes as mebibytes, for people.
fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

/// `812 of 3000 layers done`: layers 0 to 811.
fn layers_text(job: &JobView) -> String {
    format!("{} of {} layers done", job.layers_done, job.layers_total)
}

/// `1 h 05 min`, `4 min 10 s`, `12 s`.
fn duration_text(seconds: u64) -> String {
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s:02} s"),
        (h, m, _) => format!("{h} h {m:02} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
    }

    #[test]
    fn durations_read_well() {
        assert_eq!(duration_text(12), "12 s");
        assert_eq!(duration_text(250), "4 min 10 s");
        assert_eq!(duration_text(3900), "1 h 05 min");
    }
}
