//! The daemon's stream of server-sent events. `layerctl watch` and `start --wait` read them.

use std::time::Duration;

use http_body_util::BodyExt;
use hyper::body::{Bytes, Frame, Incoming};
use tokio::time::{Instant, timeout_at};

use super::connection::{Connection, MAX_ANSWER_BYTES};
use crate::api::Event;
use crate::cli::client_error::ClientError;
use crate::cli::patience::{Listener, TELL_AFTER};

/// How long the stream may be silent. The daemon sends something every second.
const MAX_SILENCE: Duration = Duration::from_secs(20);

/// The daemon's events.
#[derive(Debug)]
pub struct Events {
    body: Incoming,
    text: Vec<u8>,
    heard: Instant,
    /// Whether the present silence was reported.
    told: bool,
    listener: Listener,
    _connection: Connection,
}

impl Events {
    pub(super) fn new(body: Incoming, listener: Listener, connection: Connection) -> Self {
        Self { body, text: Vec::new(), heard: Instant::now(), told: false, listener, _connection: connection }
    }

    /// The next event; `None` when the daemon ends the stream. Cancel-safe: what was read is kept.
    ///
    /// # Errors
    /// [`ClientError::Broken`] where the daemon is gone or silent.
    pub async fn next(&mut self) -> Result<Option<Event>, ClientError> {
        loop {
            while let Some(end) = self.text.windows(2).position(|pair| pair == b"\n\n") {
                let block: Vec<u8> = self.text.drain(..end + 2).collect();
                if let Some(event) = parse_block(&block)? {
                    return Ok(Some(event));
                }
            }
            if self.text.len() > MAX_ANSWER_BYTES {
                return Err(ClientError::Broken("an event has no end".into()));
            }
            let Some(frame) = self.frame().await? else { return Ok(None) };
            if let Ok(data) = frame.map_err(ClientError::broken)?.into_data() {
                self.text.extend_from_slice(&data);
            }
        }
    }

    /// The next bytes. Reports a silence once, and its end.
    async fn frame(&mut self) -> Result<Option<Result<Frame<Bytes>, hyper::Error>>, ClientError> {
        let silence_s = MAX_SILENCE.as_secs();
        if !self.told {
            if let Ok(frame) = timeout_at(self.heard + TELL_AFTER, self.body.frame()).await {
                self.heard = Instant::now();
                return Ok(frame);
            }
            self.told = true;
            self.listener.tell(&format!(
                "layerd has been silent for {} s; waiting until it has been for {silence_s} s. A print does not depend on this \
                 command",
                TELL_AFTER.as_secs()
            ));
        }
        let frame = timeout_at(self.heard + MAX_SILENCE, self.body.frame())
            .await
            .map_err(|_| ClientError::Broken(format!("silent for {silence_s} s")))?;
        if frame.is_some() {
            self.listener.tell("layerd goes on");
        }
        (self.heard, self.told) = (Instant::now(), false);
        Ok(frame)
    }
}

/// One block of a server-sent event stream; `None` for comments and for events of a newer daemon.
fn parse_block(block: &[u8]) -> Result<Option<Event>, ClientError> {
    let text = std::str::from_utf8(block).map_err(ClientError::broken)?;
    let data: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("data:")).map(str::trim_start).collect();
    if data.is_empty() {
        return Ok(None);
    }
    Ok(serde_json::from_str(&data.join("\n")).ok())
}
