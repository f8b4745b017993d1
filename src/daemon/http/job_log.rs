//! The log of a job for `GET /v1/jobs/{id}/log`: its journal as lines of JSON, read and sent piece by piece.
//! `tests/control_api/logs.rs` shows it.

use std::path::PathBuf;

use axum::body::Body;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use hyper::body::Bytes;
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio::task::spawn_blocking;

use crate::api::{ChannelBody, ErrorBody, LogEntry, LogLine, LogRecord};
use crate::daemon::error::OrderError;
use crate::device::Passes;
use crate::job::{Entries, Entry, Record};

/// Bytes sent at once: some hundred lines.
const PIECE_BYTES: usize = 64 << 10;

/// Answers with the entries of a journal. All disk access is on a thread that may block; it keeps `place` until it is done, which
/// bounds the number of such threads.
pub(crate) async fn answer(journal: PathBuf, place: OwnedSemaphorePermit) -> Result<Response, OrderError> {
    let failed = |text: String| OrderError::new(500, text);
    let opened = spawn_blocking(move || Entries::open(&journal)).await;
    let entries = opened.map_err(|panic| failed(panic.to_string()))?.map_err(|error| failed(error.to_string()))?;
    let (pieces, body) = ChannelBody::new();
    spawn_blocking(move || {
        send(entries, &pieces);
        drop(place);
    });
    Ok(([(header::CONTENT_TYPE, "application/x-ndjson")], Body::new(body)).into_response())
}

/// Sends all entries, and what is wrong with the journal; ends early if the reader is gone. Blocks.
fn send(mut entries: Entries, pieces: &mpsc::Sender<Bytes>) {
    let mut piece = Vec::with_capacity(PIECE_BYTES);
    let mut teller = Teller::default();
    for entry in entries.by_ref() {
        let line = match entry {
            Ok(entry) => LogLine::Entry(teller.entry(entry)),
            Err(error) => LogLine::Problem(ErrorBody { error: error.to_string() }),
        };
        write(&line, &mut piece);
        if piece.len() >= PIECE_BYTES && pieces.blocking_send(std::mem::take(&mut piece).into()).is_err() {
            return;
        }
    }
    if let Some(dropped) = entries.dropped() {
        write(&LogLine::Problem(ErrorBody { error: dropped.into() }), &mut piece);
    }
    if !piece.is_empty() {
        // Sending fails if the reader is gone.
        let _ = pieces.blocking_send(piece.into());
    }
}

fn write(line: &LogLine, piece: &mut Vec<u8>) {
    serde_json::to_writer(&mut *piece, line).expect("a line is plain data, and a vector takes every byte");
    piece.push(b'\n');
}

/// Turns records into those of the log, which names layers where the journal numbers exposures.
#[derive(Default)]
struct Teller {
    /// `None` before the first record.
    passes: Option<Passes>,
}

impl Teller {
    fn entry(&mut self, Entry { at_unix_ms, record }: Entry) -> LogEntry {
        match &record {
            Record::Accepted { layer_count, .. } => self.passes = Some(Passes::single(*layer_count)),
            Record::Passes(passes) => self.passes = Some(passes.clone()),
            _ => {}
        }
        let passes = self.passes.as_ref();
        let material = passes.zip(record.exposure()).and_then(|(passes, exposure)| passes.material(exposure));
        let material = material.map(str::to_owned);
        LogEntry { at_ms: at_unix_ms, material, record: self.record(record) }
    }

    fn record(&self, record: Record) -> LogRecord {
        let layer = |exposure| self.passes.as_ref().map_or(exposure, |passes| passes.at(exposure).layer);
        match record {
            Record::Accepted { layer_count, name, .. } => LogRecord::Accepted { name, layers_total: layer_count },
            Record::Passes(passes) => LogRecord::Materials {
                names: passes.names().to_vec(),
                exposures_total: passes.exposure_count(),
                changes_total: passes.changes(),
            },
            Record::Started { exposure } => LogRecord::Started { layer: layer(exposure) },
            Record::PlateClear { traces, .. } => {
                LogRecord::PlateClear { confirmed_exposures: u32::try_from(traces.len()).unwrap_or(u32::MAX) }
            }
            Record::LastExposed { layer, .. } | Record::LastExposedPass { layer, .. } => {
                LogRecord::LastExposed { layer }
            }
            Record::Commanded { exposure, .. } => LogRecord::Commanded { layer: layer(exposure) },
            Record::Confirmed { exposure } => LogRecord::Confirmed { layer: layer(exposure) },
            Record::NotExposed { exposure } => LogRecord::NotExposed { layer: layer(exposure) },
            Record::PartlyMarked { exposure, next_vector } => {
                LogRecord::PartlyMarked { layer: layer(exposure), next_vector }
            }
            Record::Withdrawn { exposure } => LogRecord::Withdrawn { layer: layer(exposure) },
            Record::InDoubt { exposure, why } => LogRecord::InDoubt { layer: layer(exposure), why },
            Record::Decided { exposure, exposed } => LogRecord::Decided { layer: layer(exposure), exposed },
            Record::Paused => LogRecord::Paused,
            Record::Resumed => LogRecord::Resumed,
            Record::LightOff => LogRecord::LightOff,
            Record::Ordered(order) => LogRecord::Ordered { order },
            Record::Parked => LogRecord::Parked,
            Record::Dropped { what } => LogRecord::Dropped { what },
            Record::Ended { state, reason } => LogRecord::Ended { state, reason },
        }
    }
}
