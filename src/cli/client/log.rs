//! The log of a job, line by line as it arrives. `layerctl log` reads it.

use std::collections::VecDeque;

use http_body_util::BodyExt;
use hyper::body::Incoming;

use super::Client;
use super::connection::{Connection, MAX_ANSWER_BYTES};
use crate::api::{ErrorBody, LogEntry, LogLine};
use crate::cli::client_error::ClientError;
use crate::cli::patience::Wait;

/// The log of a job.
#[derive(Debug)]
pub struct Log {
    client: Client,
    body: Incoming,
    /// The beginning of a line.
    text: Vec<u8>,
    lines: VecDeque<LogLine>,
    problem: Option<String>,
    _connection: Connection,
}

impl Log {
    pub(super) fn new(client: Client, body: Incoming, connection: Connection) -> Self {
        let (text, lines) = (Vec::new(), VecDeque::new());
        Self { client, body, text, lines, problem: None, _connection: connection }
    }

    /// The next entry; `None` at the end.
    ///
    /// # Errors
    /// [`ClientError`] if the daemon breaks off or is silent.
    pub async fn next(&mut self) -> Result<Option<LogEntry>, ClientError> {
        loop {
            match self.lines.pop_front() {
                Some(LogLine::Entry(entry)) => return Ok(Some(entry)),
                Some(LogLine::Problem(ErrorBody { error })) => self.problem = Some(error),
                None => {
                    let body = &mut self.body;
                    let frame = async { body.frame().await.transpose().map_err(ClientError::broken) };
                    let frame = self.client.listener.patiently(Wait::Query, &self.client.socket, frame).await?;
                    let Some(frame) = frame else { return self.end() };
                    if let Ok(data) = frame.into_data() {
                        self.take(&data)?;
                    }
                }
            }
        }
    }

    /// Why the log cannot be read to its end; known once it has ended.
    pub fn problem(&self) -> Option<&str> {
        self.problem.as_deref()
    }

    fn end(&self) -> Result<Option<LogEntry>, ClientError> {
        if self.text.is_empty() { Ok(None) } else { Err(ClientError::Broken("the log ends within a line".into())) }
    }

    fn take(&mut self, data: &[u8]) -> Result<(), ClientError> {
        let mut lines = data.split_inclusive(|byte| *byte == b'\n');
        let Some(first) = lines.next() else { return Ok(()) };
        self.text.extend_from_slice(first);
        for next in lines {
            let line = std::mem::replace(&mut self.text, next.to_vec());
            self.lines.push_back(parse(&line)?);
        }
        if self.text.ends_with(b"\n") {
            let line = std::mem::take(&mut self.text);
            self.lines.push_back(parse(&line)?);
        }
        if self.text.len() > MAX_ANSWER_BYTES {
            return Err(ClientError::Broken("a line of the log has no end".into()));
        }
        Ok(())
    }
}

fn parse(line: &[u8]) -> Result<LogLine, ClientError> {
    serde_json::from_slice(line).map_err(|error| {
        ClientError::Broken(format!(
            "a line of the log is not understood ({error}); are layerd and layerctl of one version?"
        ))
    })
}
