//! The layers of a part, computed ahead; restarted to go on from another layer.
//! `daemon/machine/running.rs` takes its layers from it.

use std::sync::Arc;

use tokio::task::JoinHandle;

use super::{EncodedLayer, Part, PartError};
use crate::device::encoding::Choice;
use crate::stream::{Ahead, Finished, MemoryBudget};
use crate::system::spawn_blocking;

/// The sweep that computes layers; at first there is none.
#[derive(Debug, Default)]
pub struct Layers(Sweep);

#[derive(Debug, Default)]
enum Sweep {
    /// Nothing is computed.
    #[default]
    Idle,
    /// The sweep before gives its memory back; then the file is opened.
    Starting(JoinHandle<Result<Ahead<EncodedLayer>, String>>),
    /// Layers are being computed.
    Running(Ahead<EncodedLayer>),
}

impl Layers {
    /// Ends the present sweep and starts one at layer `from`. `explain` puts an error into words for the operator.
    pub fn restart(
        &mut self,
        part: &Arc<Part>,
        from: u32,
        encoding: Choice,
        budget: &MemoryBudget,
        explain: fn(&PartError) -> String,
    ) {
        let before = std::mem::take(self);
        let (part, budget) = (Arc::clone(part), budget.clone());
        self.0 = Sweep::Starting(tokio::spawn(async move {
            before.stop().await;
            let start = move || part.ahead(from, encoding, &budget, explain).map_err(|error| explain(&error));
            spawn_blocking(start).await.unwrap_or_else(|panic| Err(panic.to_string()))
        }));
    }

    /// The next layer; waits for ever if nothing is computed. Cancel-safe.
    ///
    /// # Errors
    /// A text for the operator.
    pub async fn next(&mut self) -> Result<Finished<EncodedLayer>, String> {
        loop {
            match &mut self.0 {
                Sweep::Idle => std::future::pending().await,
                Sweep::Starting(starting) => {
                    let started = starting.await.unwrap_or_else(|panic| Err(panic.to_string()));
                    self.0 = Sweep::Idle;
                    self.0 = Sweep::Running(started?);
                }
                Sweep::Running(ahead) => {
                    let next = ahead.next().await.map_err(|error| error.to_string());
                    return next?.ok_or_else(|| "the build file has fewer layers than its header says".into());
                }
            }
        }
    }

    /// Ends the present sweep; returns once its memory is given back.
    pub async fn stop(self) {
        match self.0 {
            Sweep::Idle => {}
            Sweep::Starting(starting) => {
                if let Ok(Ok(ahead)) = starting.await {
                    ahead.stop().await;
                }
            }
            Sweep::Running(ahead) => ahead.stop().await,
        }
    }
}
