//! Signals of a process that drives, or is, a machine: some end it in order, no other ends it in the middle of something.

use std::io;
use std::task::Poll;

use tokio::signal::unix::{Signal, SignalKind, signal};

/// Signals that ask for an end. `HUP`: the terminal or the connection over which the process was started is gone.
const ENDING: [(&str, i32); 4] =
    [("SIGHUP", libc::SIGHUP), ("SIGINT", libc::SIGINT), ("SIGQUIT", libc::SIGQUIT), ("SIGTERM", libc::SIGTERM)];

/// Signals that would end the process unless it takes them, and that ask for nothing it knows. `SIGPIPE` is ignored by Rust
/// itself: a write to a closed pipe is an error instead. So is one beyond the file size limit, once `SIGXFSZ` is taken.
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

/// The signals that end this process in order.
#[derive(Debug)]
pub(crate) struct Signals {
    ending: Vec<(&'static str, Signal)>,
}

impl Signals {
    /// Takes all of them over, until the process ends: a second signal during an orderly end does no harm either. Call it
    /// inside a runtime, before anything else. A `SIGHUP` that nohup(1) has put off stays off.
    ///
    /// # Errors
    /// The system allows no handlers.
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

    /// Waits for a signal that ends the process; its name. Cancel safe.
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
