//! The layers of the running job, computed ahead; restarted when the engine wants to go on from another layer.

use std::sync::Arc;

use tokio::task::JoinHandle;

use crate::daemon::part::{EncodedLayer, Part};
use crate::device::encoding::Choice;
use crate::stream::{Ahead, Finished, MemoryBudget};

/// The sweep that computes layers.
#[derive(Debug, Default)]
pub(super) enum Layers {
    /// Nothing is computed.
    #[default]
    Idle,
    /// The sweep before gives its memory back; then the file is opened.
    Starting(JoinHandle<Result<Ahead<EncodedLayer>, String>>),
    /// Layers are being computed.
    Running(Ahead<EncodedLayer>),
}

impl Layers {
    /// Ends the present sweep and starts one at layer `from`.
    pub(super) fn restart(&mut self, part: &Arc<Part>, from: u32, encoding: Choice, budget: &MemoryBudget) {
        let before = std::mem::take(self);
        let (part, budget) = (Arc::clone(part), budget.clone());
        *self = Self::Starting(tokio::spawn(async move {
            before.stop().await;
            let start = move || part.layers(from, encoding, &budget);
            tokio::task::spawn_blocking(start).await.unwrap_or_else(|panic| Err(panic.to_string()))
        }));
    }

    /// The next layer; waits for ever if nothing is computed. Cancel-safe.
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

    /// Ends the present sweep; returns once its memory is given back.
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
