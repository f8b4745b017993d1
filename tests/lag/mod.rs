//! Whether the machine that runs a test stands still now and then, as one does whose host has no time for it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A machine whose threads sleep longer than they asked for by this much is not one to measure 100 ms on.
pub(crate) const LARGEST_LAG: Duration = Duration::from_millis(20);

/// How much longer than asked for threads sleep at most, on any processor.
pub(crate) struct Lag {
    ended: Arc<AtomicBool>,
    sleepers: Vec<JoinHandle<Duration>>,
}

impl Lag {
    /// Begins to watch.
    pub(crate) fn begin() -> Self {
        let ended = Arc::new(AtomicBool::new(false));
        let sleeper = || {
            let ended = Arc::clone(&ended);
            std::thread::spawn(move || {
                let mut most = Duration::ZERO;
                while !ended.load(Ordering::Relaxed) {
                    let began = Instant::now();
                    std::thread::sleep(Duration::from_millis(2));
                    most = most.max(began.elapsed().saturating_sub(Duration::from_millis(2)));
                }
                most
            })
        };
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let sleepers = (0..processors).map(|_| sleeper()).collect();
        Self { ended, sleepers }
    }

    /// Ends it; the longest.
    pub(crate) fn end(self) -> Duration {
        self.ended.store(true, Ordering::Relaxed);
        self.sleepers.into_iter().map(|sleeper| sleeper.join().expect("ends")).max().unwrap_or_default()
    }
}
