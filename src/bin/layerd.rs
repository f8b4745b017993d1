//! The daemon on a printer's host: computes layers just ahead of the printer and sends them to it.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use layerd::daemon::Findings;

/// The daemon: prints the jobs that layerctl gives it.
#[derive(Debug, Parser)]
#[command(
    version,
    after_help = "\
Examples:
  layerd --config my/layerd.toml --check    tells what is wrong, and changes nothing
  layerd --config my/layerd.toml            then, for example: layerctl --socket my/control.sock status

The daemon runs in the foreground until SIGTERM, SIGINT (Ctrl-C), SIGQUIT or SIGHUP. Then the layer under way ends, the plate lifts \
clear of the resin, and the job can be resumed. It logs to stderr; RUST_LOG=debug tells more."
)]
struct Arguments {
    /// The daemon's configuration file.
    #[arg(long, value_name = "FILE", default_value = "/etc/layerd/layerd.toml")]
    config: PathBuf,
    /// Only check what a start needs: configuration, socket, spool, port, memory budget.
    #[arg(long)]
    check: bool,
}

fn main() -> ExitCode {
    let Arguments { config, check } = Arguments::parse();
    if check {
        return report(&config, &layerd::daemon::check(&config));
    }
    match layerd::daemon::run(&config) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            layerd::cli::report(&error);
            ExitCode::FAILURE
        }
    }
}

fn report(config: &Path, findings: &Findings) -> ExitCode {
    let Findings { errors, warnings, summary } = findings;
    warnings.iter().for_each(|warning| layerd::cli::eprint(&format!("warning: {warning}")));
    errors.iter().for_each(|error| layerd::cli::eprint(&format!("error: {error}")));
    if !errors.is_empty() {
        return ExitCode::FAILURE;
    }
    println!("{}: {}: fine", config.display(), summary.as_deref().unwrap_or_default());
    ExitCode::SUCCESS
}
