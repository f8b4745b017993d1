//! Takes a build file from a request to the spool, never holding more than one part of it in memory.

use std::path::Path;
use std::time::Duration;

use axum::body::Body;
use axum::http::{HeaderMap, header};
use http_body_util::BodyExt;
use tokio::io::AsyncWriteExt;
use tokio::time::timeout;

use super::api::{LARGEST_RECIPE_BYTES, LONGEST_NAME_BYTES, NAME_HEADER, RECIPE_HEADER, RECIPE_NAME_HEADER};
use super::handle::{CommandError, Submission};
use super::percent;
use crate::buildfile::{BEGINNING_BYTES, check_beginning};
use crate::disk;

/// A sender that is silent for longer has gone away without closing; its half file is removed.
const LONGEST_SILENCE: Duration = Duration::from_secs(30);
/// [`drain`]: a local sender that still sends is never still for so long.
const LONGEST_PAUSE: Duration = Duration::from_millis(300);
/// [`drain`]: several gigabytes pass a Unix socket in this time.
const LONGEST_DRAIN: Duration = Duration::from_secs(10);

/// Writes the request's body into `incoming` and flushes it.
///
/// `jobs_ended` is how many had when the request began.
///
/// # Errors
/// What is wrong with the request, or why it cannot be stored.
pub(super) async fn receive(
    incoming: &Path,
    headers: &HeaderMap,
    body: &mut Body,
    jobs_ended: u64,
) -> Result<Submission, CommandError> {
    let name =
        text(headers, NAME_HEADER, LONGEST_NAME_BYTES)?.filter(|name| !name.trim().is_empty()).ok_or_else(|| {
            CommandError::new(400, format!("the header {NAME_HEADER} is missing: how is the job called?"))
        })?;
    // A file's name may hold line breaks; a list of jobs has a line for each.
    let name = name.replace(char::is_control, " ");
    let recipe_text = text(headers, RECIPE_HEADER, LARGEST_RECIPE_BYTES)?;
    let recipe_name = text(headers, RECIPE_NAME_HEADER, LONGEST_NAME_BYTES)?;
    let space = Space::of(incoming)?;
    let announced = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse::<u64>().ok());
    if announced.is_some_and(|length| length > space.for_parts()) {
        return Err(space.too_little(incoming, announced));
    }
    let part = store(incoming, &name, body, space).await?;
    Ok(Submission { part, name, recipe_text, recipe_name, jobs_ended })
}

/// Reads what a refused sender still sends, so that it comes to read the answer: many clients read none before they have
/// written everything, and lose it if the connection ends meanwhile. Bounded in time, both for a pause and in all.
pub(super) async fn drain(body: &mut Body) {
    let rest = async { while let Ok(Some(Ok(_))) = timeout(LONGEST_PAUSE, body.frame()).await {} };
    let _ = timeout(LONGEST_DRAIN, rest).await;
}

async fn store(incoming: &Path, name: &str, body: &mut Body, space: Space) -> Result<tempfile::TempPath, CommandError> {
    let failed = |error: std::io::Error| {
        let status = if error.kind() == std::io::ErrorKind::StorageFull { 507 } else { 500 };
        CommandError::new(status, format!("cannot write the build file into {}: {error}", incoming.display()))
    };
    let (file, part) = tempfile::Builder::new()
        .prefix("upload-")
        .suffix(".layerd")
        .tempfile_in(incoming)
        .map_err(failed)?
        .into_parts();
    let mut file = tokio::fs::File::from_std(file);
    let mut received: u64 = 0;
    let mut beginning = Vec::with_capacity(BEGINNING_BYTES);
    loop {
        let frame = timeout(LONGEST_SILENCE, body.frame()).await.map_err(|_| {
            CommandError::new(408, format!("no data for {} s: upload given up", LONGEST_SILENCE.as_secs()))
        })?;
        let Some(frame) = frame else { break };
        let frame = frame.map_err(|error| CommandError::new(400, format!("the upload broke off: {error}")))?;
        let Ok(bytes) = frame.into_data() else { continue };
        received += bytes.len() as u64;
        if received > space.for_parts() {
            return Err(space.too_little(incoming, None));
        }
        if beginning.len() < BEGINNING_BYTES {
            // What is no build file is refused before gigabytes of it have come.
            beginning.extend_from_slice(&bytes[..bytes.len().min(BEGINNING_BYTES - beginning.len())]);
            check_beginning(&beginning).map_err(|problem| CommandError::new(422, format!("{name}: {problem}")))?;
        }
        file.write_all(&bytes).await.map_err(failed)?;
    }
    if received == 0 {
        return Err(CommandError::new(400, "the body is empty: send the build file's bytes"));
    }
    file.flush().await.map_err(failed)?;
    file.sync_all().await.map_err(failed)?;
    Ok(part)
}

/// Room on the spool's disk.
#[derive(Clone, Copy)]
struct Space {
    free_bytes: u64,
}

impl Space {
    fn of(directory: &Path) -> Result<Self, CommandError> {
        let free_bytes = disk::free_bytes(directory).map_err(|error| {
            CommandError::new(500, format!("cannot tell the free space of {}: {error}", directory.display()))
        })?;
        Ok(Self { free_bytes })
    }

    fn for_parts(self) -> u64 {
        self.free_bytes.saturating_sub(disk::RESERVE_BYTES)
    }

    fn too_little(self, incoming: &Path, announced: Option<u64>) -> CommandError {
        let need = announced.map_or_else(|| "more than that".into(), |bytes| format!("{bytes} bytes"));
        let (place, free_bytes, reserve) = (incoming.display(), self.free_bytes, disk::RESERVE_BYTES);
        let text = format!(
            "the disk of {place} has {free_bytes} bytes free; {reserve} of them are kept for journals, and the build file needs \
             {need}: `layerctl remove JOB` deletes finished jobs; or delete other files there, or move the spool"
        );
        CommandError::new(507, text)
    }
}

/// One percent-encoded header as text of at most `limit` bytes.
fn text(headers: &HeaderMap, header: &str, limit: usize) -> Result<Option<String>, CommandError> {
    let Some(value) = headers.get(header) else { return Ok(None) };
    let text = percent::decode(value.as_bytes())
        .ok_or_else(|| CommandError::new(400, format!("the header {header} is not percent-encoded UTF-8")))?;
    if text.len() > limit {
        let message = format!("the header {header} holds {} bytes; at most {limit} are allowed", text.len());
        return Err(CommandError::new(400, message));
    }
    Ok(Some(text))
}
