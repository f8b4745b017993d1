//! The layers of the running job, computed ahead; restarted where the engine wants to go on from another layer.

use std::sync::Arc;

use tokio::task::JoinHandle;

use super::part::{EncodedLayer, Part};
use crate::device::encoding::Choice;
use crate::stream::{Ahead, Finished, MemoryBudget};

/// A sweep, or none, or one being started.
#[derive(Debug, Default)]
pub(super) enum Layers {
    /// Nothing is computed.
    #[default]
    Idle,
    /// The file is being opened, after the sweep before has given its memory back.
    Starting(JoinHandle<Result<Ahead<EncodedLayer>, String>>),
    /// Layers come.
    Running(Ahead<EncodedLayer>),
}

impl Layers {
    /// Ends what runs and starts at layer `from`.
    pub(super) fn restart(&mut self, part: &Arc<Part>, from: u32, encoding: Choice, budget: &MemoryBudget) {
        let before = std::mem::take(self);
        let (part, budget) = (Arc::clone(part), budget.clone());
        *self = Self::Starting(tokio::spawn(async move {
            before.stop().await;
            let start = move || part.layers(from, encoding, &budget);
            tokio::task::spawn_blocking(start).await.unwrap_or_else(|panic| Err(panic.to_string()))
        }));
    }

    /// The next layer; waits for ever where nothing is computed. Cancel safe.
    ///
    /// # Errors
    /// A text for the operator.
    pub(super) async fn next(&mut self) -> Result<Finished<EncodedLayer>, String> {
        loop {
            match self {
                Self::Idle => std::future::pending().await,
                Self::Starting(starting) => {
                    let started = starting.await.unwrap_or_else(|panic| Err(panic.to_string()));
                    *self = Self::Idle;
                    *self = Self::Running(started?);
                }
                Self::Running(ahead) => {
                    let next = ahead.next().await.map_err(|error| error.to_string());
                    return next?.ok_or_else(|| "the build file has fewer layers than its header says".into());
                }
            }
        }
    }

    /// Ends what runs; returns once its memory is given back.
    pub(super) async fn stop(self) {
        match self {
            Self::Idle => {}
            Self::Starting(starting) => {
                if let Ok(Ok(ahead)) = starting.await {
                    ahead.stop().await;
                }
            }
            Self::Running(ahead) => ahead.stop().await,
        }
    }
}
