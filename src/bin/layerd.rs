//! The daemon on the host of a printer: it computes layers just ahead of the printer and sends them to it.
//!
//! `layerd --config config/layerd.toml --check` checks a configuration; README.md shows a first start.

use std::path::Path;
use std::process::ExitCode;

use clap::Parser;
use layerd::daemon::{Arguments, Findings};

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
    let told = format!("{}: {}: fine", config.display(), summary.as_deref().unwrap_or_default());
    match layerd::cli::print(&told) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            layerd::cli::report(&error);
            ExitCode::FAILURE
        }
    }
}
