//! Writes a build file from a request into the spool, with at most one piece of it in memory.
//! `tests/control_api/uploads.rs` tests it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use axum::body::Body;
use axum::http::{HeaderMap, header};
use http_body_util::BodyExt;
use tokio::sync::OwnedSemaphorePermit;
use tokio::time::timeout;

use crate::api::percent;
use crate::api::{MAX_NAME_BYTES, MAX_RECIPE_BYTES, NAME_HEADER, RECIPE_HEADER, RECIPE_NAME_HEADER};
use crate::daemon::error::OrderError;
use crate::daemon::fit::Fit;
use crate::daemon::handle::Submission;
use crate::disk::{self, File, TempPath};
use crate::pipeline::{BEGINNING_BYTES, check_beginning};
use crate::system::spawn_blocking;
use crate::text::size_text;

/// A sender that is silent for longer is gone; the incomplete file is removed.
const MAX_SILENCE: Duration = Duration::from_secs(30);
/// Size of one write: large enough that handing it to a thread costs little, small compared with the memory budget.
const PIECE_BYTES: usize = 256 << 10;
/// [`drain`] ends after a pause this long: a local sender that is still sending makes none.
const MAX_PAUSE: Duration = Duration::from_millis(300);
/// [`drain`] ends after this time: several gigabytes pass a Unix socket in it.
const MAX_DRAIN_TIME: Duration = Duration::from_secs(10);

/// Writes the request's body into `incoming` and flushes it. First checks the job's recipe against `fit`. Returns `place`
/// with the new job.
///
/// `jobs_ended` is the number of jobs that had ended when the request began.
///
/// # Errors
/// What is wrong with the request, or why it cannot be stored.
pub async fn receive(
    incoming: &Path,
    headers: &HeaderMap,
    body: &mut Body,
    jobs_ended: u64,
    fit: Option<Fit>,
    place: OwnedSemaphorePermit,
) -> Result<(Submission, OwnedSemaphorePermit), OrderError> {
    let name = text(headers, NAME_HEADER, MAX_NAME_BYTES)?.filter(|name| !name.trim().is_empty()).ok_or_else(|| {
        OrderError::new(400, format!("the header {NAME_HEADER} is missing: it must hold the job's name"))
    })?;
    // A file's name may hold line breaks, but a list of jobs has one line for each.
    let name = name.replace(char::is_control, " ");
    let (recipe_text, recipe_name) = recipe(headers)?;
    if let Some(fit) = fit {
        fit.check(recipe_text.as_deref(), recipe_name.as_deref())?;
    }
    let announced = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse::<u64>().ok());
    let (part, place) = store(incoming, &name, announced, body, place).await?;
    Ok((Submission { part, name, recipe_text, recipe_name, jobs_ended }, place))
}

/// Text and name of the recipe that a request names.
///
/// # Errors
/// 400 for a header that is too long or not percent-encoded UTF-8.
pub(super) fn recipe(headers: &HeaderMap) -> Result<(Option<String>, Option<String>), OrderError> {
    Ok((text(headers, RECIPE_HEADER, MAX_RECIPE_BYTES)?, text(headers, RECIPE_NAME_HEADER, MAX_NAME_BYTES)?))
}

/// Reads and drops what a refused sender still sends: many clients read the answer only after they have sent everything, and
/// lose it if the connection ends before. Limited by [`MAX_PAUSE`] and [`MAX_DRAIN_TIME`].
pub(crate) async fn drain(body: &mut Body) {
    let rest = async { while let Ok(Some(Ok(_))) = timeout(MAX_PAUSE, body.frame()).await {} };
    let _ = timeout(MAX_DRAIN_TIME, rest).await;
}

/// Writes the body into a file of its own and flushes it.
async fn store(
    incoming: &Path,
    name: &str,
    announced: Option<u64>,
    body: &mut Body,
    place: OwnedSemaphorePermit,
) -> Result<(TempPath, OwnedSemaphorePermit), OrderError> {
    let mut target = Target::create(incoming, announced, place).await?;
    match fill(&mut target, name, body).await {
        Ok(()) => target.finish().await,
        Err(error) => {
            target.remove().await;
            Err(error)
        }
    }
}

async fn fill(target: &mut Target, name: &str, body: &mut Body) -> Result<(), OrderError> {
    let mut received: u64 = 0;
    let mut beginning = Vec::with_capacity(BEGINNING_BYTES);
    let mut piece = Vec::with_capacity(PIECE_BYTES);
    loop {
        let frame = timeout(MAX_SILENCE, body.frame())
            .await
            .map_err(|_| OrderError::new(408, format!("no data for {} s: upload given up", MAX_SILENCE.as_secs())))?;
        let Some(frame) = frame else { break };
        let frame = frame.map_err(|error| OrderError::new(400, format!("the upload broke off: {error}")))?;
        let Ok(bytes) = frame.into_data() else { continue };
        received += bytes.len() as u64;
        if received > target.space.for_parts() {
            return Err(target.space.too_little(&target.incoming, None));
        }
        if beginning.len() < BEGINNING_BYTES {
            // A file that is no build file is refused before gigabytes of it arrive.
            beginning.extend_from_slice(&bytes[..bytes.len().min(BEGINNING_BYTES - beginning.len())]);
            check_beginning(&beginning).map_err(|problem| OrderError::new(422, format!("{name}: {problem}")))?;
        }
        piece.extend_from_slice(&bytes);
        if piece.len() >= PIECE_BYTES {
            piece = target.write(piece).await?;
        }
    }
    if received == 0 {
        return Err(OrderError::new(400, "the body is empty: send the build file's bytes"));
    }
    target.write(piece).await?;
    Ok(())
}

/// A file that is being received. All disk access is on threads that may block, so that a disk that hangs cannot keep the API from
/// answering. The upload keeps its place until such a thread is done, even if the sender is gone; this bounds their number.
struct Target {
    incoming: PathBuf,
    space: Space,
    /// `None` while a thread works on it, and after that thread has failed.
    file: Option<TargetFile>,
}

struct TargetFile {
    file: File,
    written_bytes: u64,
    path: TempPath,
    place: OwnedSemaphorePermit,
}

impl Target {
    async fn create(incoming: &Path, announced: Option<u64>, place: OwnedSemaphorePermit) -> Result<Self, OrderError> {
        let incoming = incoming.to_path_buf();
        on_disk(move || {
            let space = Space::of(&incoming)?;
            if announced.is_some_and(|length| length > space.for_parts()) {
                return Err(space.too_little(&incoming, announced));
            }
            let (path, file) = TempPath::file_in(&incoming, "upload-").map_err(|error| failed(&incoming, &error))?;
            Ok(Self { incoming, space, file: Some(TargetFile { file, written_bytes: 0, path, place }) })
        })
        .await
    }

    /// Appends a piece; returns its buffer, empty.
    async fn write(&mut self, mut piece: Vec<u8>) -> Result<Vec<u8>, OrderError> {
        let Some(mut target) = self.file.take() else { return Err(OrderError::new(500, "the upload has ended")) };
        let incoming = self.incoming.clone();
        let (target, piece) = on_disk(move || {
            let written = target.file.write_all_at(&piece, target.written_bytes);
            written.map_err(|error| failed(&incoming, &error))?;
            target.written_bytes += piece.len() as u64;
            piece.clear();
            Ok((target, piece))
        })
        .await?;
        self.file = Some(target);
        Ok(piece)
    }

    /// Flushes the file.
    async fn finish(mut self) -> Result<(TempPath, OwnedSemaphorePermit), OrderError> {
        let Some(target) = self.file.take() else { return Err(OrderError::new(500, "the upload has ended")) };
        let incoming = self.incoming.clone();
        on_disk(move || {
            target.file.sync_all().map_err(|error| failed(&incoming, &error))?;
            Ok((target.path, target.place))
        })
        .await
    }

    /// Deletes the file, and waits for that.
    async fn remove(&mut self) {
        if let Some(target) = self.file.take() {
            // A panic in it was reported when it happened.
            let _ = spawn_blocking(move || drop(target)).await;
        }
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        // The sender is gone.
        if let Some(target) = self.file.take() {
            spawn_blocking(move || drop(target));
        }
    }
}

/// Runs `work` on a thread that may wait for the disk.
async fn on_disk<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, OrderError> + Send + 'static,
) -> Result<T, OrderError> {
    spawn_blocking(work).await.map_err(|panic| OrderError::new(500, format!("the upload failed: {panic}")))?
}

fn failed(incoming: &Path, error: &std::io::Error) -> OrderError {
    let status = if error.kind() == std::io::ErrorKind::StorageFull { 507 } else { 500 };
    OrderError::new(status, format!("cannot write the build file into {}: {error}", incoming.display()))
}

/// Room on the spool's disk.
#[derive(Clone, Copy)]
struct Space {
    free_bytes: u64,
}

impl Space {
    fn of(directory: &Path) -> Result<Self, OrderError> {
        let free_bytes = disk::free_bytes(directory).map_err(|error| {
            // It was there when the daemon started.
            let remedy = match error.kind() {
                std::io::ErrorKind::NotFound => {
                    ": the spool was moved or deleted while layerd ran; put it back, or restart layerd"
                }
                _ => "",
            };
            OrderError::new(500, format!("cannot tell the free space of {}: {error}{remedy}", directory.display()))
        })?;
        Ok(Self { free_bytes })
    }

    fn for_parts(self) -> u64 {
        self.free_bytes.saturating_sub(disk::RESERVE_BYTES)
    }

    fn too_little(self, incoming: &Path, announced: Option<u64>) -> OrderError {
        let need = announced.map_or_else(|| "more than that".into(), size_text);
        let (place, free, reserve) = (incoming.display(), size_text(self.free_bytes), size_text(disk::RESERVE_BYTES));
        let text = format!(
            "the disk of {place} has {free} free; {reserve} must stay free for journals, and the build file needs {need}: \
             `layerctl remove JOB` deletes jobs that are over; or delete other files there, or move the spool"
        );
        OrderError::new(507, text)
    }
}

/// One percent-encoded header as text of at most `limit` bytes.
fn text(headers: &HeaderMap, header: &str, limit: usize) -> Result<Option<String>, OrderError> {
    let Some(value) = headers.get(header) else { return Ok(None) };
    let text = percent::decode(value.as_bytes())
        .ok_or_else(|| OrderError::new(400, format!("the header {header} is not percent-encoded UTF-8")))?;
    if text.len() > limit {
        let message = format!("the header {header} holds {} bytes; at most {limit} are allowed", text.len());
        return Err(OrderError::new(400, message));
    }
    Ok(Some(text))
}
