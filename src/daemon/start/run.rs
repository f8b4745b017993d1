//! From a configuration file to a running daemon, and back down on a signal. `tests/signals.rs` tries the way down.

use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context;
use tokio::net::UnixListener;
use tokio::sync::watch;

use super::check::before_start;
use super::daemon::{Daemon, together};
use crate::daemon::host::log;
use crate::daemon::host::notify;
use crate::daemon::http::server;
use crate::daemon::http::socket;
use crate::daemon::setting::Setting;
use crate::link::SystemPorts;
use crate::signals::Signals;

/// Threads of the main runtime: one moves the line's bytes while the other runs the printer. The layers and both control sockets
/// have threads of their own, so that connections cannot delay an order on its way to the device.
const RUNTIME_THREADS: usize = 2;
/// How long the daemon waits at its end for disk writes under way, and for a part that is being sampled: a disk that hangs must not
/// keep it from ending.
const MAX_WRITE_TIME: Duration = Duration::from_secs(2);

/// Runs the daemon until SIGTERM, SIGINT, SIGQUIT or SIGHUP; returns once the machine is safe. It logs to stderr.
///
/// # Errors
/// Configuration, spool or socket keep it from starting, or the machine could not be made safe.
pub fn run(config: &Path) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(RUNTIME_THREADS)
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let ended = runtime.block_on(async {
        // First of all: from here on no signal kills this process in the middle of its work.
        let signals = Signals::take_over().context("cannot wait for signals")?;
        // Dropped last, so that waiting lines are written before the final error.
        let _log = log::to_stderr().context("cannot start the log")?;
        serve(load(config)?, signals).await
    });
    runtime.shutdown_timeout(MAX_WRITE_TIME);
    ended
}

/// Reads the configuration and checks what it names.
fn load(place: &Path) -> anyhow::Result<Setting> {
    let setting = Setting::load(place, Setting::config(place)?).map_err(|errors| anyhow::anyhow!(together(&errors)))?;
    let findings = before_start(&setting, place);
    findings.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    if findings.errors.is_empty() { Ok(setting) } else { Err(anyhow::anyhow!(findings.errors.join("\nerror: "))) }
}

async fn serve(setting: Setting, mut signals: Signals) -> anyhow::Result<()> {
    let (place, socket) = (setting.config.spool.clone(), setting.config.socket.clone());
    let daemon = Daemon::new(setting)?;
    let handle = daemon.handle();
    let [control, aborts] = socket::bind(&socket).await?;
    let (shutdown, ending) = watch::channel(false);
    // The API answers until the machine is safe: an abort must get through while the last exposure ends.
    let (hang_up, over) = watch::channel(false);
    let (abort_handle, abort_over) = (handle.clone(), over.clone());
    let servers = [
        serve_in_thread("control api", control, |listener| server::serve(listener, handle, place, over))?,
        serve_in_thread("aborts", aborts, |listener| server::serve_aborts(listener, abort_handle, abort_over))?,
    ];
    let mut printer = tokio::spawn(daemon.run(Arc::new(SystemPorts), ending));
    notify::ready();
    tracing::info!(socket = %socket.display(), "ready");
    let ended = tokio::select! {
        signal = signals.end() => {
            tracing::info!("{signal}: ending, the machine is made safe");
            None
        }
        ended = &mut printer => Some(ended),
    };
    // Sending fails if the printer has ended.
    let _ = shutdown.send(true);
    let printed = match ended {
        Some(ended) => ended,
        None => printer.await,
    };
    let _ = hang_up.send(true);
    for server in servers {
        // A panic in it was reported when it happened.
        let _ = server.join();
    }
    for path in [&socket::abort_path(&socket), &socket] {
        let _ = std::fs::remove_file(path);
    }
    printed.context("the printer's loop ended with a panic; the device's own limits keep it safe")?
}

/// Serves a socket in a thread and a runtime of its own.
fn serve_in_thread<F: Future<Output = ()>>(
    name: &str,
    listener: UnixListener,
    serve: impl FnOnce(UnixListener) -> F + Send + 'static,
) -> anyhow::Result<JoinHandle<()>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let (runtime, listener) = (runtime.context("cannot start a runtime")?, listener.into_std()?);
    let run = move || {
        runtime.block_on(async {
            match UnixListener::from_std(listener) {
                Ok(listener) => serve(listener).await,
                Err(error) => tracing::error!(%error, "a control socket cannot be served"),
            }
        });
        runtime.shutdown_timeout(MAX_WRITE_TIME);
    };
    std::thread::Builder::new().name(name.into()).spawn(run).context("cannot start a thread")
}
