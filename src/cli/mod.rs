//! `layerctl`, the operator's command. Exit codes: 0 done, 1 failed, 2 wrong usage; `start --wait`: 3 aborted or stopped,
//! 4 interrupted and resumable; 130 `start` was ended by Ctrl-C; 141 nobody reads stdout any more.
//!
//! Layers are numbered from 0 in files, protocol and texts: "layer 812" is that of `layer_000812.png`. Progress is a count:
//! "812 of 3000 layers done" means that layers 0 to 811 are done and layer 812 is next.
//! `tests/cli.rs` tries codes and messages.

pub mod check;
pub mod client;
mod client_error;
mod commands;
mod demo;
mod device;
pub mod generate;
pub mod info;
mod jobs;
mod log;
mod manual;
pub mod pack;
mod patience;
mod progress;
mod raise;
mod remove;
mod settings;
pub mod simulate;
pub mod slice;
mod start;
mod status;
mod watch;

use std::borrow::Cow;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::OnceLock;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::buildfile::{Joint, Keeps, PackError};
use crate::config::{ConfigText, Folder, Machine, Recipe, find};
use crate::text::{is_hidden, plain, shell_word};

/// Prepares lattices for printing, and tells the daemon layerd to print them.
#[derive(Debug, Parser)]
#[command(name = "layerctl", version, propagate_version = true, after_help = EXAMPLES)]
struct Arguments {
    /// Socket of the daemon to speak to [default: $LAYERD_SOCKET, else /run/layerd/control.sock].
    #[arg(long, global = true, value_name = "PATH")]
    socket: Option<PathBuf>,
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "\
From a part to a print:
  layerctl pack lattice.3mf -o lattice.layerd
  layerctl check lattice.layerd --machine sim-dlp --recipe default
  layerctl start lattice.layerd --recipe default --wait
  layerctl watch

Of these, start and watch speak to the daemon, as status, jobs, log, device, pause, resume, stop, abort, raise and remove do. A daemon \
run by hand has a socket of its own: name it with --socket PATH, or once for all with export LAYERD_SOCKET=PATH. If the daemon \
does not answer, a command says so after 2 s. It gives up a query after 5 s, an order after 30 s, an abort after 60 s.

\"Layer 812\" is always the layer of the file layer_000812.png: the first is layer 0. \"812 of 3000 layers done\" is a count: \
layers 0 to 811 are done, and layer 812 is next.

Exit codes: 0 done, 1 failed, 2 wrong usage; start --wait: 3 aborted or stopped, 4 interrupted (resumable), 130 ended by Ctrl-C; \
141 nobody reads the output any more.";

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a build file of lattices and solids (3MF, STL, OBJ, PLY, edge text).
    Pack(Box<pack::PackArgs>),
    /// Make a build file of a synthetic lattice.
    Generate(generate::GenerateArgs),
    /// Show what is in a build file, and how much resin the part takes.
    Info(info::InfoArgs),
    /// Check before a print whether a part fits the machine, the memory and the line, and holds to the plate.
    ///
    /// For a laser, all layers are computed, or evenly spaced ones if that takes too long.
    Check(check::CheckArgs),
    /// List the machines whose names other commands take.
    #[command(after_help = settings::MACHINES_HELP)]
    Machines(settings::ListArgs),
    /// List the recipes whose names other commands take.
    #[command(after_help = settings::RECIPES_HELP)]
    Recipes(settings::ListArgs),
    /// Write the layers of a part as pictures, the same that a print sends.
    Slice(slice::SliceArgs),
    /// Simulate a printer on a pseudo-terminal.
    Simulate(simulate::SimulateArgs),
    /// The daemon itself, so that `demo` needs no second program.
    #[command(hide = true)]
    Daemon {
        /// The daemon's configuration file.
        #[arg(long)]
        config: std::path::PathBuf,
    },
    /// Print a build file, or the part of an earlier job again: give it to the daemon as a new job.
    Start(start::StartArgs),
    /// Show machine, line, jobs, memory and traffic.
    Status(status::StatusArgs),
    /// Follow the print in the terminal; keys pause, resume, stop and abort it.
    Watch(watch::WatchArgs),
    /// List the jobs that the daemon remembers, the oldest first.
    Jobs(jobs::JobsArgs),
    /// Tell what happened to a job: its layers, pauses, doubts, orders and its end.
    Log(log::LogArgs),
    /// Show what the device is, and where light and plate are.
    Device(device::DeviceArgs),
    /// Pause the job after the layer under way; a plate in resin lifts clear of it.
    #[command(after_help = commands::pause_help())]
    Pause(commands::JobArgs),
    /// Let a paused or interrupted job go on, or confirm that the plate is empty so that a job begins.
    Resume(commands::ResumeArgs),
    /// End the job after the layer under way; a plate in resin lifts clear of it.
    #[command(after_help = commands::stop_help())]
    Stop(commands::JobArgs),
    /// End the job at once: the light goes off, then a plate in resin lifts clear of it.
    #[command(after_help = commands::ABORT_HELP)]
    Abort(commands::JobArgs),
    /// Lift the plate clear of the resin while no job runs.
    Raise(raise::RaiseArgs),
    /// Delete jobs that are over, with their parts and records.
    Remove(remove::RemoveArgs),
    /// Write man pages and shell completions.
    Manual(manual::ManualArgs),
    /// Print a lattice on a simulated printer, and compare the result.
    Demo(demo::DemoArgs),
}

/// The socket of `--socket`. Commands that texts suggest then name it, too.
static NAMED_SOCKET: OnceLock<PathBuf> = OnceLock::new();

/// Commands that speak to the daemon.
const TO_DAEMON: [&str; 12] =
    ["start", "status", "watch", "jobs", "log", "device", "pause", "resume", "stop", "abort", "raise", "remove"];

/// Adds `--socket` to the commands that the text suggests, if it was given: otherwise they would speak to another daemon.
fn with_socket(text: &str) -> Cow<'_, str> {
    match NAMED_SOCKET.get() {
        Some(socket) if text.contains("layerctl ") => Cow::Owned(naming(text, &socket.to_string_lossy())),
        _ => Cow::Borrowed(text),
    }
}

fn naming(text: &str, socket: &str) -> String {
    let socket = shell_word(socket);
    TO_DAEMON.iter().fold(text.to_owned(), |text, command| {
        text.replace(&format!("layerctl {command}"), &format!("layerctl --socket {socket} {command}"))
    })
}

/// Writes one line to stderr, with hidden characters escaped.
pub fn eprint(text: &str) {
    crate::text::eprint(&with_socket(text));
}

/// How a command ended, beyond "failed" (an error, exit code 1) and "wrong usage" (clap, exit code 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ending {
    Done,
    Failed,
    Aborted,
    Interrupted,
    /// Ended by Ctrl-C.
    Signal,
}

impl From<Ending> for ExitCode {
    fn from(ending: Ending) -> Self {
        match ending {
            Ending::Done => Self::SUCCESS,
            Ending::Failed => Self::from(1),
            Ending::Aborted => Self::from(3),
            Ending::Interrupted => Self::from(4),
            // As in shells: 128 plus the signal's number.
            Ending::Signal => Self::from(130),
        }
    }
}

/// Parses the command line and carries it out; errors go to stderr with their causes.
pub fn run() -> ExitCode {
    let arguments = Arguments::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit());
    // Before there are other threads.
    progress::offset_at_start();
    if let Some(socket) = arguments.socket {
        // Nothing has read it yet.
        let _ = NAMED_SOCKET.set(socket);
    }
    match dispatch(arguments.command) {
        Ok(ending) => ending.into(),
        // As in shells: 128 plus the number of SIGPIPE, which ends other programs here.
        Err(error) if error.is::<ClosedPipe>() => ExitCode::from(141),
        Err(error) => {
            report(&error);
            // A wrong value of an option is wrong usage, even if it is found later than clap's checks.
            let is_usage = matches!(error.downcast_ref(), Some(PackError::Option(_)));
            ExitCode::from(if is_usage { 2 } else { 1 })
        }
    }
}

/// The command line. Every option takes `-5` as a value, so that its own check reports it; clap would suggest the use of `--`.
fn command() -> clap::Command {
    let values = |argument: clap::Arg| match argument.get_action().takes_values() {
        true => argument.allow_negative_numbers(true),
        false => argument,
    };
    Arguments::command().mut_subcommands(|command| command.mut_args(values))
}

fn dispatch(command: Command) -> anyhow::Result<Ending> {
    match command {
        Command::Pack(args) => pack::run(*args).map(done),
        Command::Manual(args) => manual::run(&args).map(done),
        Command::Machines(args) => settings::machines(&args).map(done),
        Command::Recipes(args) => settings::recipes(&args).map(done),
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
        Command::Log(args) => log::run(&args),
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

/// Writes `error: …` to stderr, and each cause that the text does not already contain.
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

/// Runs requests to the daemon on this thread.
fn block_on<T>(conversation: impl Future<Output = anyhow::Result<T>>) -> anyhow::Result<T> {
    tokio::runtime::Builder::new_current_thread().enable_all().build()?.block_on(conversation)
}

/// Writes one JSON object to stdout.
fn print_json(value: &impl serde::Serialize) -> anyhow::Result<()> {
    let mut line = String::new();
    for character in serde_json::to_string(value)?.chars() {
        // JSON allows these unescaped, but a terminal would obey or hide them.
        if is_hidden(character) {
            let mut units = [0; 2];
            character.encode_utf16(&mut units).iter().for_each(|unit| line.push_str(&format!("\\u{unit:04x}")));
        } else {
            line.push(character);
        }
    }
    write_line(&line)
}

/// Nobody reads stdout any more, as after `layerctl status | head -1`. The command ends without a word.
#[derive(Debug, thiserror::Error)]
#[error("nobody reads stdout")]
struct ClosedPipe;

/// Writes a text to stdout, with hidden characters escaped.
///
/// # Errors
/// Nobody reads stdout, or it cannot be written.
pub fn print(text: &str) -> anyhow::Result<()> {
    write_line(&plain(&with_socket(text)))
}

/// Writes to stdout. A closed pipe is an error of its own, not a panic as with `println!`.
fn write_line(text: &str) -> anyhow::Result<()> {
    use std::io::Write;
    writeln!(std::io::stdout().lock(), "{text}").map_err(|error| match error.kind() {
        std::io::ErrorKind::BrokenPipe => ClosedPipe.into(),
        _ => anyhow::anyhow!("cannot write to stdout: {error}"),
    })
}

/// Adds to a help text where names of machines and recipes are looked up.
fn with_names(help: &str) -> String {
    format!(
        "{help}\n\nA machine or recipe is a path or a name: of a file in machines/ or recipes/ below $LAYERD_CONFIG_DIR, \
         /etc/layerd or config, or of one built in."
    )
}

/// Loads a machine by path or name. Returns its file as well.
fn find_machine(machine: &str) -> anyhow::Result<(Machine, PathBuf)> {
    let ConfigText { path, text } = find(Folder::Machines, machine)?;
    Ok((Machine::parse(&path, &text)?, path))
}

/// Loads a machine, and a recipe for it, each by path or name.
fn find_pair(machine: &str, recipe: &str) -> anyhow::Result<(Machine, Recipe)> {
    let (machine, place) = find_machine(machine)?;
    let ConfigText { path, text } = find(Folder::Recipes, recipe)?;
    let recipe = Recipe::parse_for(&machine, &place, &path, &text)?;
    Ok((machine, recipe))
}

/// A progress bar on stderr, of an indicatif template; invisible if stderr is no terminal.
fn progress_bar(template: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr_with_hz(5));
    bar.with_style(ProgressStyle::with_template(template).expect("our own templates are well-formed"))
}

/// A joint's name and, of a convolution, its support R in millimetres, as JSON has them.
fn joint_figures(joint: Joint) -> (&'static str, Option<f64>) {
    match joint {
        Joint::Convolution { support_um } => ("convolution", Some(support_um / 1000.0)),
        Joint::Elliptic { support_um, .. } => ("elliptic", Some(support_um / 1000.0)),
        Joint::Union => ("union", None),
    }
}

/// Which part of a lattice a clip leaves, as JSON has it.
fn keeps_text(keeps: Keeps) -> &'static str {
    match keeps {
        Keeps::Inside => "inside",
        Keeps::Outside => "outside",
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
    fn commands_to_copy_name_the_socket_that_was_given() {
        let told =
            naming("`layerctl resume 2`, then `layerctl status`; `layerctl pack` asks nobody", "/tmp/a b/x.sock");
        assert_eq!(
            told,
            "`layerctl --socket '/tmp/a b/x.sock' resume 2`, then `layerctl --socket '/tmp/a b/x.sock' status`; `layerctl pack` \
             asks nobody"
        );
        for command in TO_DAEMON {
            assert!(super::command().find_subcommand(command).is_some(), "{command}");
        }
    }
}
