//! A task that computes layers ahead of the printer, and the bounded queue of those it has finished. It waits as a task, and computes
//! each layer on a thread for work that may block.
//!
//! The queue is limited in bytes, which are charged to the memory budget, and in layers. The bytes of a layer become free when its
//! [`Room`] is dropped, so a layer that is being uploaded still counts. One more layer may wait for room; the producer charges it
//! together with its own buffers. `pipeline` streams the layers of a print with it.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::JoinHandle;

use super::{BudgetExceeded, Charge, MemoryBudget};
use crate::system::spawn_blocking;
use crate::text::size_text;

/// Most finished layers in the queue: enough to bridge any delay, few enough that a resumed or aborted job discards little work. Without
/// this limit thousands of small layers would queue.
const MAX_QUEUE_LAYERS: usize = 64;

/// Unit of the semaphore. Its permits are a `u32`, so counting single bytes would limit the queue to 4 GiB.
const PERMIT_BYTES: u64 = 1024;

/// A layer that is ready.
#[derive(Debug)]
pub struct Finished<T> {
    /// What was computed.
    pub layer: T,
    /// How long computing it took.
    pub compute_time: Duration,
    /// Its share of the queue; keep it as long as the layer's bytes.
    pub room: Room,
}

/// A share of the queue. Dropping it frees the share.
#[derive(Debug)]
pub struct Room {
    _permit: OwnedSemaphorePermit,
    /// The queue's bytes stay charged while any layer of it is held.
    _charge: Arc<Charge>,
}

/// Why no further layer comes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StreamError {
    /// The queue does not fit the memory budget.
    #[error(transparent)]
    Budget(#[from] BudgetExceeded),
    /// The computation failed; the text says why.
    #[error("{0}")]
    Failed(String),
    /// One layer alone is larger than the queue.
    #[error(
        "a finished layer takes {}, but the queue of finished layers has only {}; raise memory_budget",
        size_text(*layer_bytes), size_text(*queue_bytes)
    )]
    LayerTooLarge {
        /// Size of the layer.
        layer_bytes: u64,
        /// Size of the whole queue.
        queue_bytes: u64,
    },
    /// The computation panicked; the panic's own message is on stderr.
    #[error("the computing thread ended unexpectedly; its panic message is in the daemon's log")]
    Panicked,
}

/// Result of one computing step: a layer and the bytes that it takes, or `None` after the last layer.
pub type Produced<T> = Result<Option<(T, u64)>, String>;

/// Layers computed ahead, in order.
#[derive(Debug)]
pub struct Ahead<T> {
    finished: mpsc::Receiver<Result<Finished<T>, StreamError>>,
    room: Arc<Semaphore>,
    task: JoinHandle<()>,
}

impl<T: Send + 'static> Ahead<T> {
    /// Starts computing. `produce` is called, on other threads, until it returns `None` or an error, or until `Ahead` is dropped.
    ///
    /// # Errors
    /// [`StreamError::Budget`] if `queue_bytes` are not free in the budget.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub fn start(
        budget: &MemoryBudget,
        queue_bytes: u64,
        produce: impl FnMut() -> Produced<T> + Send + 'static,
    ) -> Result<Self, StreamError> {
        let charge = budget.charge("the queue of finished layers", queue_bytes)?;
        let permits = u32::try_from(queue_bytes / PERMIT_BYTES).unwrap_or(u32::MAX);
        let room = Arc::new(Semaphore::new(permits as usize));
        let (sender, finished) = mpsc::channel(MAX_QUEUE_LAYERS);
        let worker = Worker { sender, room: Arc::clone(&room), permits, charge: Arc::new(charge) };
        let task = tokio::spawn(worker.run(produce));
        Ok(Self { finished, room, task })
    }

    /// Waits for the next layer; `None` after the last. Cancel safe.
    ///
    /// # Errors
    /// [`StreamError`], once; no layer follows.
    pub async fn next(&mut self) -> Result<Option<Finished<T>>, StreamError> {
        self.finished.recv().await.transpose()
    }

    /// Stops computing and waits until the memory is free, at most for the time of one layer.
    pub async fn stop(mut self) {
        self.room.close();
        self.finished.close();
        // Layers in the queue hold room; drop them.
        while self.finished.recv().await.is_some() {}
        // Its panic, if any, was reported when it happened.
        let _ = (&mut self.task).await;
    }
}

impl<T> Drop for Ahead<T> {
    fn drop(&mut self) {
        // Wakes the task if it waits for room. It then ends by itself.
        self.room.close();
    }
}

struct Worker<T> {
    room: Arc<Semaphore>,
    permits: u32,
    charge: Arc<Charge>,
    /// Dropped last, so that the memory is free when the receiver sees the end of the queue.
    sender: mpsc::Sender<Result<Finished<T>, StreamError>>,
}

impl<T: Send + 'static> Worker<T> {
    async fn run(self, mut produce: impl FnMut() -> Produced<T> + Send + 'static) {
        loop {
            let work = move || {
                let began = Instant::now();
                let step = catch_unwind(AssertUnwindSafe(&mut produce));
                (produce, step, began.elapsed())
            };
            let step = match spawn_blocking(work).await {
                Ok((same, step, compute_time)) => {
                    produce = same;
                    match step {
                        Ok(Ok(None)) => break,
                        Ok(Ok(Some((layer, bytes)))) => self.queue(layer, bytes, compute_time).await,
                        Ok(Err(text)) => Err(StreamError::Failed(text)),
                        // `produce` is not used again.
                        Err(_) => Err(StreamError::Panicked),
                    }
                }
                // `produce` is gone: the thread failed outside of it, or the daemon ends.
                Err(_) => {
                    let _ = self.sender.send(Err(StreamError::Panicked)).await;
                    return;
                }
            };
            let failed = step.is_err();
            let Some(message) = step.transpose() else { break };
            if self.sender.send(message).await.is_err() || failed {
                break;
            }
        }
        // The slicer's threads end with it, which may take a moment.
        let _ = spawn_blocking(move || drop(produce)).await;
    }

    /// Waits for room; `None` if the receiver is gone.
    async fn queue(&self, layer: T, bytes: u64, compute_time: Duration) -> Result<Option<Finished<T>>, StreamError> {
        let needed = u32::try_from(bytes.div_ceil(PERMIT_BYTES)).unwrap_or(u32::MAX);
        if needed > self.permits {
            let queue_bytes = u64::from(self.permits) * PERMIT_BYTES;
            return Err(StreamError::LayerTooLarge { layer_bytes: bytes, queue_bytes });
        }
        let room = Arc::clone(&self.room).acquire_many_owned(needed).await;
        Ok(room.ok().map(|permit| Finished {
            layer,
            compute_time,
            room: Room { _permit: permit, _charge: Arc::clone(&self.charge) },
        }))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    fn counting(total: u32, bytes: u64, made: Arc<AtomicU32>) -> impl FnMut() -> Produced<u32> + Send {
        move || {
            let layer = made.fetch_add(1, Ordering::SeqCst);
            Ok((layer < total).then_some((layer, bytes)))
        }
    }

    /// Waits until `count` layers were computed, and checks that there are no more.
    async fn until(made: &AtomicU32, count: u32) {
        let began = Instant::now();
        while made.load(Ordering::SeqCst) < count {
            assert!(began.elapsed() < Duration::from_secs(60), "waited in vain for {count} layers");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        assert_eq!(made.load(Ordering::SeqCst), count);
    }

    #[tokio::test]
    async fn layers_come_in_order_and_the_queue_holds_no_more_than_its_bytes() {
        let budget = MemoryBudget::new(10 << 10);
        let made = Arc::new(AtomicU32::new(0));
        let mut ahead = Ahead::start(&budget, 4 << 10, counting(20, 1 << 10, Arc::clone(&made))).expect("fits");
        assert_eq!(budget.used_bytes(), 4 << 10);
        let held = ahead.next().await.expect("computed").expect("first");
        // One held by us, three waiting, one computed and waiting for room.
        until(&made, 5).await;
        assert_eq!(held.layer, 0);
        drop(held);
        for expected in 1..20 {
            assert_eq!(ahead.next().await.expect("computed").expect("a layer").layer, expected);
            assert!(made.load(Ordering::SeqCst) <= expected + 1 + 5, "four with room, one that waits for it");
        }
        assert!(ahead.next().await.expect("ended well").is_none());
        drop(ahead);
        assert_eq!(budget.used_bytes(), 0);
    }

    #[tokio::test]
    async fn stop_gives_the_memory_back_while_a_layer_waits_for_room() {
        let budget = MemoryBudget::new(4 << 10);
        let made = Arc::new(AtomicU32::new(0));
        let ahead = Ahead::start(&budget, 4 << 10, counting(u32::MAX, 1 << 10, Arc::clone(&made))).expect("fits");
        assert!(Ahead::start(&budget, 1, counting(1, 1, Arc::default())).is_err(), "the budget is taken");
        until(&made, 5).await;
        ahead.stop().await;
        assert_eq!(budget.used_bytes(), 0);
    }

    #[tokio::test]
    async fn failures_are_told_apart() {
        let budget = MemoryBudget::new(8 << 10);
        let mut failing = Ahead::<u32>::start(&budget, 1 << 10, || Err("chunk 3 is corrupt".into())).expect("fits");
        assert_eq!(failing.next().await.err(), Some(StreamError::Failed("chunk 3 is corrupt".into())));
        let mut large = Ahead::start(&budget, 1 << 10, counting(1, 5000, Arc::default())).expect("fits");
        let expected = StreamError::LayerTooLarge { layer_bytes: 5000, queue_bytes: 1024 };
        assert_eq!(large.next().await.err(), Some(expected));
        let mut panicking = Ahead::<u32>::start(&budget, 1 << 10, || panic!("on purpose")).expect("fits");
        assert_eq!(panicking.next().await.err(), Some(StreamError::Panicked));
    }
}
