//! Work on other threads that may wait for a disk. The printer's loop reads its results from a queue (`daemon/background.rs`).

use std::pin::Pin;
use std::task::{Context, Poll};

use tokio::sync::oneshot;

/// The result of work on another thread. The work goes on if this is dropped.
#[derive(Debug)]
pub(crate) struct Blocking<T>(oneshot::Receiver<T>);

/// The work ended with a panic, which was reported when it happened; or it was never begun, because the daemon is ending.
#[derive(Clone, Copy, Debug, thiserror::Error)]
#[error("a thread ended unexpectedly; its panic message is in the daemon's log")]
pub(crate) struct Panicked;

/// Runs work that may wait for a disk on a thread for such work.
///
/// # Panics
/// Outside a tokio runtime.
pub(crate) fn spawn_blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Blocking<T> {
    let (sender, receiver) = oneshot::channel();
    super::with(|system| {
        system.spawn_blocking(Box::new(move || {
            // Nobody may wait for it.
            let _ = sender.send(work());
        }));
    });
    Blocking(receiver)
}

impl<T> Future for Blocking<T> {
    type Output = Result<T, Panicked>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        Pin::new(&mut self.0).poll(context).map_err(|_| Panicked)
    }
}
