//! The daemon's command line. `layerd --help` shows it.

use std::path::PathBuf;

use clap::Parser;

/// The daemon: prints the jobs that layerctl gives it.
#[derive(Debug, Parser)]
#[command(
    name = "layerd",
    version,
    after_help = "\
Examples:
  layerd --config my/layerd.toml --check    tells what is wrong, and changes nothing
  layerd --config my/layerd.toml            then, for example: layerctl --socket my/control.sock status

The daemon runs in the foreground until SIGTERM, SIGINT (Ctrl-C), SIGQUIT or SIGHUP. Then the layer under way ends, the plate lifts \
clear of the resin, and the job can be resumed. It logs to stderr; RUST_LOG=debug tells more."
)]
pub struct Arguments {
    /// The daemon's configuration file.
    #[arg(long, value_name = "FILE", default_value = "/etc/layerd/layerd.toml")]
    pub config: PathBuf,
    /// Only check what a start needs: configuration, socket, spool, port, memory budget.
    #[arg(long)]
    pub check: bool,
}
