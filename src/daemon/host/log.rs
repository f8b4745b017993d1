//! The daemon's log: lines to stderr, written by a thread of its own.
//!
//! Logging never blocks: a terminal that is stopped, or a full or closed pipe, holds up only this thread. Lines that repeat are
//! counted ([`limit`]), so that no device can fill a disk with them. `tests/daemon_log.rs` shows it.

mod limit;

use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::MakeWriter;
use tracing_subscriber::fmt::format::debug_fn;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{Layer, field::MakeExt};

use self::limit::Limiter;
use crate::text::plain_line;

/// Lines that wait for stderr: some hundred kilobytes. Further lines are dropped and counted.
const MAX_WAITING_LINES: usize = 1024;
/// How often the thread looks for windows of repeated lines that have ended.
const LOOK: Duration = Duration::from_secs(1);
/// How long the daemon waits at its end for a stderr that takes nothing.
const MAX_LAST_LINES_TIME: Duration = Duration::from_secs(1);

/// The log of this process. Dropping it writes the lines that wait.
#[derive(Debug)]
pub(crate) struct Log {
    queue: SyncSender<Entry>,
}

#[derive(Debug)]
enum Entry {
    Line(Vec<u8>),
    /// Write the counts of repeated lines, then report that it is done.
    Close(SyncSender<()>),
}

/// Sends the log to stderr; `RUST_LOG` sets the level. Under systemd, lines have no time: the journal adds it.
///
/// # Errors
/// The system cannot start a thread.
pub(crate) fn to_stderr() -> io::Result<Log> {
    let (queue, entries) = sync_channel(MAX_WAITING_LINES);
    let lost = Arc::new(AtomicU64::new(0));
    let limiter = Limiter::default();
    let writer = Writer { limiter: limiter.clone(), lost: Arc::clone(&lost) };
    std::thread::Builder::new().name("log".into()).spawn(move || writer.run(&entries))?;
    // Enough for this program, and without the regular expressions of `EnvFilter`, which make a program half a megabyte larger.
    let filter = std::env::var("RUST_LOG").ok().and_then(|text| text.parse::<Targets>().ok());
    let filter = filter.unwrap_or_else(|| Targets::new().with_default(tracing::Level::INFO));
    // Each event is one line: text of devices and files is escaped.
    let fields = debug_fn(|writer, field, value| match field.name() {
        "message" => write!(writer, "{}", plain_line(&format!("{value:?}"))),
        name => write!(writer, "{name}={}", plain_line(&format!("{value:?}"))),
    });
    let lines = tracing_subscriber::fmt::layer()
        .fmt_fields(fields.delimited(" "))
        .with_writer(Queue { queue: queue.clone(), lost })
        .with_target(false)
        // These go to stderr directly, and panic if it is closed.
        .log_internal_errors(false);
    let lines = if std::env::var_os("JOURNAL_STREAM").is_some() {
        lines.without_time().with_ansi(false).boxed()
    } else {
        lines.with_ansi(io::stderr().is_terminal()).boxed()
    };
    // A second log in one process happens only by mistake in a test; the first one stays.
    let _ = tracing_subscriber::registry().with(lines).with(limiter).with(filter).try_init();
    Ok(Log { queue })
}

impl Drop for Log {
    fn drop(&mut self) {
        let (done, closed) = sync_channel(1);
        let began = Instant::now();
        let mut entry = Entry::Close(done);
        while let Err(TrySendError::Full(back)) = self.queue.try_send(entry) {
            if began.elapsed() >= MAX_LAST_LINES_TIME {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
            entry = back;
        }
        let _ = closed.recv_timeout(MAX_LAST_LINES_TIME);
    }
}

/// Puts formatted lines into the queue without waiting.
#[derive(Clone)]
struct Queue {
    queue: SyncSender<Entry>,
    lost: Arc<AtomicU64>,
}

impl<'a> MakeWriter<'a> for Queue {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

impl Write for Queue {
    /// Takes one whole line: the subscriber writes each at once.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if self.queue.try_send(Entry::Line(line.to_vec())).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The thread that writes.
struct Writer {
    limiter: Limiter,
    lost: Arc<AtomicU64>,
}

impl Writer {
    fn run(&self, entries: &Receiver<Entry>) {
        let mut looked = Instant::now();
        loop {
            match entries.recv_timeout(LOOK) {
                Ok(Entry::Line(line)) => self.write(&line),
                Ok(Entry::Close(done)) => {
                    self.limiter.tell_all();
                    while let Ok(Entry::Line(line)) = entries.try_recv() {
                        self.write(&line);
                    }
                    let _ = done.send(());
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if looked.elapsed() >= LOOK {
                looked = Instant::now();
                self.limiter.tell_due(looked);
            }
        }
    }

    /// Errors are ignored: the daemon goes on when nobody reads its stderr.
    fn write(&self, line: &[u8]) {
        let mut stderr = io::stderr().lock();
        let lost = self.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let _ = writeln!(stderr, "{lost} lines of the log are lost: stderr took nothing");
        }
        let _ = stderr.write_all(line);
    }
}
