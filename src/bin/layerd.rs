//! The daemon on a printer's host: computes layers just ahead of the printer and sends them to it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;

/// Prints jobs given to it by `layerctl`.
#[derive(Debug, Parser)]
#[command(
    version,
    after_help = "\
The daemon runs in the foreground until SIGTERM or Ctrl-C, which end the print dark, plate clear, and resumable.
It logs to stderr; RUST_LOG=debug tells more.

Examples:
  layerd --config /etc/layerd/layerd.toml --check
  layerd --config config/layerd.toml"
)]
struct Arguments {
    /// The daemon's configuration file.
    #[arg(long, value_name = "FILE", default_value = "/etc/layerd/layerd.toml")]
    config: PathBuf,
    /// Only check the configuration, its machine and its recipe.
    #[arg(long)]
    check: bool,
}

fn main() -> ExitCode {
    let Arguments { config, check } = Arguments::parse();
    let ended = if check {
        layerd::daemon::Setting::load(&config).map(|setting| {
            println!(
                "{}: machine `{}`, recipe `{}`: fine",
                config.display(),
                setting.machine.name,
                setting.recipe.name
            );
        })
    } else {
        layerd::daemon::log_to_stderr();
        layerd::daemon::run(&config)
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            layerd::cli::report(&error);
            ExitCode::FAILURE
        }
    }
}
