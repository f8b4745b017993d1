//! Signals of a process that drives or simulates a machine: some make it end in an orderly way; the others do not kill it.
//! `daemon/start/run.rs` and `layerctl simulate` call it first.

use std::io;
use std::task::Poll;

use tokio::signal::unix::{Signal, SignalKind, signal};

/// Signals that request an orderly end. `SIGHUP`: the terminal or connection from which the process was started is gone.
const ENDING: [(&str, i32); 4] =
    [("SIGHUP", libc::SIGHUP), ("SIGINT", libc::SIGINT), ("SIGQUIT", libc::SIGQUIT), ("SIGTERM", libc::SIGTERM)];

/// Signals that would kill the process unless it handles them, and that mean nothing to it. Rust itself ignores `SIGPIPE`: writing
/// to a closed pipe is an error instead. With a handler for `SIGXFSZ`, so is writing beyond the file size limit.
const HARMLESS: [i32; 9] = [
    libc::SIGUSR1,
    libc::SIGUSR2,
    libc::SIGALRM,
    libc::SIGVTALRM,
    libc::SIGPROF,
    libc::SIGIO,
    libc::SIGPWR,
    libc::SIGXCPU,
    libc::SIGXFSZ,
];

/// The signals that request an orderly end.
#[derive(Debug)]
pub(crate) struct Signals {
    ending: Vec<(&'static str, Signal)>,
}

impl Signals {
    /// Installs handlers for all of them until the process ends, so that a second signal during an orderly end does no harm. Call
    /// it inside a runtime, before anything else. A `SIGHUP` that nohup(1) has disabled stays ignored.
    ///
    /// # Errors
    /// The system refuses a handler.
    pub(crate) fn take_over() -> io::Result<Self> {
        for number in HARMLESS {
            // The handler stays when the stream is dropped.
            drop(signal(SignalKind::from_raw(number))?);
        }
        let is_wanted = |number| number != libc::SIGHUP || !is_ignored(number);
        let wanted = ENDING.into_iter().filter(|(_, number)| is_wanted(*number));
        let ending = wanted.map(|(name, number)| Ok((name, signal(SignalKind::from_raw(number))?)));
        Ok(Self { ending: ending.collect::<io::Result<_>>()? })
    }

    /// Waits for a signal that requests an end; returns its name. Cancel-safe.
    pub(crate) async fn end(&mut self) -> &'static str {
        std::future::poll_fn(|context| {
            let mut came = self.ending.iter_mut().filter_map(|(name, signal)| match signal.poll_recv(context) {
                Poll::Ready(_) => Some(*name),
                Poll::Pending => None,
            });
            came.next().map_or(Poll::Pending, Poll::Ready)
        })
        .await
    }
}

/// Whether the process was started with this signal ignored.
fn is_ignored(number: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok());
    ignored.is_some_and(|mask| mask & (1 << (number - 1)) != 0)
}
