//! Sends a build file as a new job, and waits until the daemon has checked it. `layerctl start` calls it.

use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::time::Duration;

use http_body_util::{Either, Full};
use hyper::body::Bytes;
use hyper::http::request::Builder;
use hyper::{Method, header};
use tokio::fs::File;
use tokio::io::AsyncReadExt;
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout};

use super::Client;
use super::connection::{Answer, exchange, read, request};
use crate::api::{ChannelBody, JobView, NAME_HEADER, RECIPE_HEADER, RECIPE_NAME_HEADER, percent};
use crate::cli::client_error::ClientError;
use crate::cli::patience::{TELL_AFTER, Wait};

/// How long the daemon may check a submitted part: reading ten gigabytes from a slow disk takes some minutes.
const MAX_CHECK_TIME: Duration = Duration::from_secs(900);
/// Bytes read from the build file at a time.
const PART_BYTES: usize = 64 << 10;

/// A new job to submit.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// The build file.
    pub part: PathBuf,
    /// Name of the job, for people.
    pub name: String,
    /// The recipe's name and TOML text; `None` for the daemon's default.
    pub recipe: Option<(String, String)>,
}

/// An open build file.
struct Part<'a> {
    path: &'a Path,
    file: File,
    total_bytes: u64,
}

impl<'a> Part<'a> {
    async fn open(path: &'a Path) -> Result<Self, ClientError> {
        let file = File::open(path).await.map_err(|source| unreadable(path, source))?;
        let metadata = file.metadata().await.map_err(|source| unreadable(path, source))?;
        if !metadata.is_file() {
            return Err(unreadable(path, std::io::Error::other("not a file")));
        }
        Ok(Self { path, file, total_bytes: metadata.len() })
    }

    /// The next bytes of a file of which `sent` bytes are sent. Never more than were there when it was opened.
    async fn next(&mut self, sent: u64) -> Result<Vec<u8>, ClientError> {
        let mut bytes = Vec::with_capacity(PART_BYTES);
        let limit = (self.total_bytes - sent).min(PART_BYTES as u64);
        let read = (&mut self.file).take(limit).read_buf(&mut bytes).await;
        if read.map_err(|source| unreadable(self.path, source))? == 0 {
            let source = std::io::Error::other("the file became shorter while it was sent");
            return Err(unreadable(self.path, source));
        }
        Ok(bytes)
    }
}

fn with_recipe(request: Builder, recipe: Option<&(String, String)>) -> Builder {
    let Some((name, text)) = recipe else { return request };
    request.header(RECIPE_NAME_HEADER, percent::encode(name)).header(RECIPE_HEADER, percent::encode(text))
}

fn unreadable(path: &Path, source: std::io::Error) -> ClientError {
    ClientError::Part { path: path.into(), source }
}

impl Client {
    /// Sends a build file as a new job; calls `progress` with the bytes sent and the total.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn submit(&self, job: &NewJob, progress: impl FnMut(u64, u64)) -> Result<JobView, ClientError> {
        let part = Part::open(&job.part).await?;
        let request = request(Method::POST, "/v1/jobs")
            .header(NAME_HEADER, percent::encode(&job.name))
            .header(header::CONTENT_LENGTH, part.total_bytes);
        let request = with_recipe(request, job.recipe.as_ref());
        let (parts, body) = ChannelBody::new();
        let request = request.body(Either::Right(body)).map_err(ClientError::broken)?;
        let upload = self.upload(part, parts, progress);
        let exchange = exchange(self.socket(), request);
        tokio::pin!(upload, exchange);
        tokio::select! {
            // The daemon may refuse before everything is sent.
            answer = &mut exchange => return self.answer(answer?).await,
            uploaded = &mut upload => uploaded?,
        }
        self.answer(self.checked(exchange).await?).await
    }

    /// Submits the part of job `id`, which is over, as a new job: with the same recipe, or with another one of this name and text.
    ///
    /// # Errors
    /// [`ClientError`]; status 409 if the job is not over or its part is no longer there.
    pub async fn again(&self, id: &str, recipe: Option<&(String, String)>) -> Result<JobView, ClientError> {
        let request = request(Method::POST, &format!("/v1/jobs/{}/again", percent::encode(id)));
        let request = with_recipe(request, recipe).body(Either::Left(Full::default())).map_err(ClientError::broken)?;
        let exchange = exchange(self.socket(), request);
        tokio::pin!(exchange);
        self.answer(self.checked(exchange).await?).await
    }

    /// Sends the part's bytes, until all are sent or the daemon takes no more.
    async fn upload(
        &self,
        mut part: Part<'_>,
        parts: mpsc::Sender<Bytes>,
        mut progress: impl FnMut(u64, u64),
    ) -> Result<(), ClientError> {
        let mut sent = 0;
        while sent < part.total_bytes {
            let bytes = part.next(sent).await?;
            let count = bytes.len() as u64;
            let taken = async { Ok(parts.send(bytes.into()).await.is_ok()) };
            if !self.listener.patiently(Wait::Upload, self.socket(), taken).await? {
                break; // The daemon has answered early; its answer says why.
            }
            sent += count;
            progress(sent, part.total_bytes);
        }
        Ok(())
    }

    /// Waits while the daemon checks a part that was sent. Meanwhile asks for its status, to see that it is alive.
    async fn checked(
        &self,
        mut exchange: Pin<&mut impl Future<Output = Result<Answer, ClientError>>>,
    ) -> Result<Answer, ClientError> {
        let (until, limit_min) = (Instant::now() + MAX_CHECK_TIME, MAX_CHECK_TIME.as_secs() / 60);
        let mut told = false;
        while Instant::now() < until {
            if let Ok(answer) = timeout(TELL_AFTER, &mut exchange).await {
                return answer;
            }
            tokio::select! {
                answer = &mut exchange => return answer,
                status = self.status() => match status {
                    // A daemon that refuses for lack of room is alive.
                    Ok(_) | Err(ClientError::Refused { .. }) => {}
                    Err(error) => return Err(error),
                },
            }
            if !std::mem::replace(&mut told, true) {
                self.listener.tell(&format!("layerd has the part and checks it; waiting up to {limit_min} min"));
            }
        }
        Err(ClientError::Broken(format!(
            "the part was not checked within {limit_min} min; `layerctl jobs` tells later whether the job was taken"
        )))
    }

    async fn answer(&self, answer: Answer) -> Result<JobView, ClientError> {
        self.listener.patiently(Wait::Upload, &self.socket, read(answer)).await
    }
}
