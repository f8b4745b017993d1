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
    let space = free_bytes(incoming)?.saturating_sub(disk::RESERVE_BYTES);
    let announced = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse::<u64>().ok());
    if announced.is_some_and(|length| length > space) {
        return Err(no_space(incoming, announced, space));
    }
    let part = store(incoming, body, space).await?;
    Ok(Submission { part, name, recipe_text, recipe_name, jobs_ended })
}

/// Reads what a refused sender still sends, so that it comes to read the answer: many clients read none before they have
/// written everything, and lose it if the connection ends meanwhile. Bounded in time, both for a pause and in all.
pub(super) async fn drain(body: &mut Body) {
    let rest = async { while let Ok(Some(Ok(_))) = timeout(LONGEST_PAUSE, body.frame()).await {} };
    let _ = timeout(LONGEST_DRAIN, rest).await;
}

async fn store(incoming: &Path, body: &mut Body, space: u64) -> Result<tempfile::TempPath, CommandError> {
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
    loop {
        let frame = timeout(LONGEST_SILENCE, body.frame()).await.map_err(|_| {
            CommandError::new(408, format!("no data for {} s: upload given up", LONGEST_SILENCE.as_secs()))
        })?;
        let Some(frame) = frame else { break };
        let frame = frame.map_err(|error| CommandError::new(400, format!("the upload broke off: {error}")))?;
        let Ok(bytes) = frame.into_data() else { continue };
        received += bytes.len() as u64;
        if received > space {
            return Err(no_space(incoming, None, space));
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

fn no_space(incoming: &Path, announced: Option<u64>, space: u64) -> CommandError {
    let need = announced.map_or_else(|| "more".into(), |bytes| format!("{bytes} bytes"));
    let place = incoming.display();
    CommandError::new(
        507,
        format!(
            "the build file needs {need}, but only {space} bytes are free for it in {place}: remove old jobs or files"
        ),
    )
}

fn free_bytes(directory: &Path) -> Result<u64, CommandError> {
    disk::free_bytes(directory).map_err(|error| {
        CommandError::new(500, format!("cannot tell the free space of {}: {error}", directory.display()))
    })
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
