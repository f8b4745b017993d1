//! From a configuration file to a running daemon, and back down on SIGTERM.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use tracing_subscriber::EnvFilter;

use super::api::{BudgetView, DeviceView, LineView, LinkState, LinkView};
use super::handle::{self, Snapshot};
use super::jobs::Jobs;
use super::line::Line;
use super::printer::Printer;
use super::setting::Setting;
use super::{notify, server};
use crate::job::Spool;
use crate::stream::MemoryBudget;

/// The runtime's own threads: one moves the line's bytes while the other serves the API. Layers have threads of their own.
const RUNTIME_THREADS: usize = 2;

/// Sends the log to stderr; `RUST_LOG` says how much. Under systemd, whose journal knows the time, without times.
pub fn log_to_stderr() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    if std::env::var_os("JOURNAL_STREAM").is_some() {
        log.without_time().with_ansi(false).init();
    } else {
        log.with_ansi(std::io::stderr().is_terminal()).init();
    }
}

/// Runs the daemon until SIGTERM or SIGINT; returns once the machine is safe.
///
/// # Errors
/// What keeps it from starting: configuration, spool, socket.
pub fn run(config: &Path) -> anyhow::Result<()> {
    let setting = Setting::load(config)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(RUNTIME_THREADS)
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    runtime.block_on(serve(setting))
}

async fn serve(setting: Setting) -> anyhow::Result<()> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let spool = Spool::open(&setting.config.spool)?;
    let incoming = spool.incoming();
    let jobs = Jobs::load(spool.jobs()?, spool.forgotten()?, setting.machine.confirm_plate);
    let listener = server::bind(&setting.config.socket).await?;
    let budget = MemoryBudget::new(setting.config.memory_budget);
    let (handle, desk) = handle::channel(first_snapshot(&setting, &jobs));
    let (shutdown, ending) = watch::channel(false);
    // The API answers until the machine is safe: an abort must get through while a last exposure ends.
    let (hang_up, over) = watch::channel(false);
    let link = setting.machine.link.clone();
    let socket = setting.config.socket.clone();
    let server = tokio::spawn(server::serve(listener, handle, incoming, over));
    let printer = Printer::new(Arc::new(setting), spool, jobs, budget, desk, Line::start(link));
    let mut printer = tokio::spawn(printer.run(ending));
    notify::ready();
    tracing::info!(socket = %socket.display(), "ready");
    let ended = tokio::select! {
        _ = terminate.recv() => None,
        _ = interrupt.recv() => None,
        ended = &mut printer => Some(ended),
    };
    tracing::info!("ending: the machine is made safe");
    // Nobody may be left to hear it.
    let _ = shutdown.send(true);
    let printed = match ended {
        Some(ended) => ended,
        None => printer.await,
    };
    let _ = hang_up.send(true);
    let _ = server.await;
    let _ = std::fs::remove_file(&socket);
    printed.context("the printer's loop ended with a panic; the device's own limits keep it safe")?
}

fn first_snapshot(setting: &Setting, jobs: &Jobs) -> Snapshot {
    let path = setting.machine.link.path.display().to_string();
    Snapshot {
        machine: setting.machine.name.clone(),
        link: LinkView { state: LinkState::Connecting, path, device: None, reason: None },
        device: DeviceView::default(),
        budget: BudgetView::default(),
        line: LineView::default(),
        jobs_ended: 0,
        jobs: jobs.views(),
    }
}
