//! The control API as `layerctl` and other programs call it.

mod connection;
mod events;

use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::time::Duration;

use http_body_util::{Either, Full};
use hyper::body::Bytes;
use hyper::{Method, Request, header};
use serde::de::DeserializeOwned;
use tokio::io::AsyncReadExt;
use tokio::time::{Instant, timeout};

use self::connection::{Answer, RequestBody, accepted, exchange, post, read, request};
pub use self::events::Events;
pub use super::client_error::ClientError;
use super::patience::{Listener, TELL_AFTER, Wait};
use crate::config::DEFAULT_SOCKET;
use crate::daemon::api::{
    JobList, JobView, NAME_HEADER, RECIPE_HEADER, RECIPE_NAME_HEADER, RaiseView, RemovedView, ResumeBody, Status,
};
use crate::daemon::{ChannelBody, percent_encode, socket};

/// The daemon reads a submitted part once from its disk: ten gigabytes from a slow one take some minutes.
const MAX_CHECK_TIME: Duration = Duration::from_secs(900);
/// A crowd on the socket for aborts may push one out before the daemon has read it.
const ABORT_TRIES: usize = 3;
/// Bytes read from the build file at a time.
const PART_BYTES: usize = 64 << 10;

/// A new job, as an operator gives it.
#[derive(Clone, Debug)]
pub struct NewJob {
    /// The build file.
    pub part: PathBuf,
    /// For people.
    pub name: String,
    /// The recipe's name and TOML text; `None` for the daemon's default.
    pub recipe: Option<(String, String)>,
}

/// The daemon, as seen from here.
#[derive(Clone, Debug)]
pub struct Client {
    socket: PathBuf,
    listener: Listener,
}

impl Client {
    /// The daemon at the socket of `--socket`, else of `$LAYERD_SOCKET`, else at [`DEFAULT_SOCKET`]. What a long wait is for is
    /// said on stderr.
    pub fn from_environment() -> Self {
        let of_environment = || std::env::var_os("LAYERD_SOCKET").filter(|path| !path.is_empty()).map(PathBuf::from);
        let socket = super::NAMED_SOCKET.get().cloned().or_else(of_environment);
        Self::new(socket.unwrap_or_else(|| DEFAULT_SOCKET.into())).telling(super::eprint)
    }

    /// The daemon at `socket`. Waits are silent.
    pub fn new(socket: impl Into<PathBuf>) -> Self {
        Self { socket: socket.into(), listener: Listener::new(|_| {}) }
    }

    /// The same daemon; `hear` is told what is being waited for where that takes longer than two seconds.
    #[must_use]
    pub fn telling(self, hear: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self { listener: Listener::new(hear), ..self }
    }

    /// The socket.
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// Everything at a glance.
    ///
    /// # Errors
    /// [`ClientError`], as for every other call.
    pub async fn status(&self) -> Result<Status, ClientError> {
        self.get("/v1/status").await
    }

    /// Every job the daemon remembers.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn jobs(&self) -> Result<Vec<JobView>, ClientError> {
        Ok(self.get::<JobList>("/v1/jobs").await?.jobs)
    }

    /// One job.
    ///
    /// # Errors
    /// [`ClientError`]; status 404 where there is none.
    pub async fn job(&self, id: &str) -> Result<JobView, ClientError> {
        self.get(&format!("/v1/jobs/{}", percent_encode(id))).await
    }

    /// Reads `path`, such as `/v1/device`.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, ClientError> {
        self.get_within(Wait::Query, path).await
    }

    /// The same for an order that depends on the answer: as patient as the order, and an error says that it was not given.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn look_up<T: DeserializeOwned>(&self, path: &str) -> Result<T, ClientError> {
        self.get_within(Wait::LookUp, path).await
    }

    async fn get_within<T: DeserializeOwned>(&self, wait: Wait, path: &str) -> Result<T, ClientError> {
        let request = request(Method::GET, path).body(Either::Left(Full::default()));
        self.ask(wait, request.map_err(ClientError::broken)?).await
    }

    /// Gives a job an order: `pause`, `stop` or `abort`.
    ///
    /// # Errors
    /// [`ClientError`]; status 409 where the job's state does not allow it.
    pub async fn order(&self, id: &str, order: &str) -> Result<JobView, ClientError> {
        let path = format!("/v1/jobs/{}/{order}", percent_encode(id));
        if order == "abort" { self.post_abort(&path).await } else { self.post(Wait::Order, &path, Bytes::new()).await }
    }

    /// Lets a paused or interrupted job go on.
    ///
    /// # Errors
    /// [`ClientError`]; status 409 where a layer is in doubt and `body` does not resolve it.
    pub async fn resume(&self, id: &str, body: ResumeBody) -> Result<JobView, ClientError> {
        let bytes = serde_json::to_vec(&body).map_err(ClientError::broken)?;
        self.post(Wait::Order, &format!("/v1/jobs/{}/resume", percent_encode(id)), bytes.into()).await
    }

    /// Light off now, whichever job is active.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn abort_active(&self) -> Result<JobView, ClientError> {
        self.post_abort("/v1/abort").await
    }

    /// By the socket that is for aborts alone; by the common one where that is not there or too crowded. A second abort does
    /// no harm.
    async fn post_abort(&self, path: &str) -> Result<JobView, ClientError> {
        let aborts = Self { socket: socket::abort_path(&self.socket), ..self.clone() };
        let conversation = async {
            for _ in 0..ABORT_TRIES {
                match aborts.ask_once(post(path, Bytes::new())?).await {
                    Err(ClientError::Broken(_)) => {}
                    Err(
                        ClientError::NoDaemon { .. } | ClientError::NotAllowed { .. } | ClientError::SocketPath { .. },
                    ) => {
                        break;
                    }
                    answered => return answered,
                }
            }
            self.ask_once(post(path, Bytes::new())?).await
        };
        self.listener.patiently(Wait::Abort, &self.socket, conversation).await
    }

    /// Lifts the plate clear of the resin while no job runs.
    ///
    /// # Errors
    /// [`ClientError`]; status 409 where a job has the machine, or the plate cannot be moved.
    pub async fn raise(&self) -> Result<RaiseView, ClientError> {
        self.post(Wait::Order, "/v1/raise", Bytes::new()).await
    }

    /// Deletes a finished job.
    ///
    /// # Errors
    /// [`ClientError`]; status 409 where the job is not over.
    pub async fn remove(&self, id: &str) -> Result<RemovedView, ClientError> {
        let request = request(Method::DELETE, &format!("/v1/jobs/{}", percent_encode(id)));
        let request = request.body(Either::Left(Full::default())).map_err(ClientError::broken)?;
        self.ask(Wait::Order, request).await
    }

    async fn post<T: DeserializeOwned>(&self, wait: Wait, path: &str, body: Bytes) -> Result<T, ClientError> {
        self.ask(wait, post(path, body)?).await
    }

    async fn ask<T: DeserializeOwned>(&self, wait: Wait, request: Request<RequestBody>) -> Result<T, ClientError> {
        self.listener.patiently(wait, &self.socket, self.ask_once(request)).await
    }

    /// Without a limit in time.
    async fn ask_once<T: DeserializeOwned>(&self, request: Request<RequestBody>) -> Result<T, ClientError> {
        read(exchange(&self.socket, request).await?).await
    }

    /// Sends a build file as a new job; `progress` hears bytes sent and bytes in all.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn submit(&self, job: &NewJob, mut progress: impl FnMut(u64, u64)) -> Result<JobView, ClientError> {
        let unreadable = |source| ClientError::Part { path: job.part.clone(), source };
        let mut file = tokio::fs::File::open(&job.part).await.map_err(unreadable)?;
        let metadata = file.metadata().await.map_err(unreadable)?;
        if !metadata.is_file() {
            return Err(unreadable(std::io::Error::other("not a file")));
        }
        let total = metadata.len();
        let mut request = request(Method::POST, "/v1/jobs")
            .header(NAME_HEADER, percent_encode(&job.name))
            .header(header::CONTENT_LENGTH, total);
        if let Some((name, text)) = &job.recipe {
            request =
                request.header(RECIPE_NAME_HEADER, percent_encode(name)).header(RECIPE_HEADER, percent_encode(text));
        }
        let (parts, body) = ChannelBody::new();
        let request = request.body(Either::Right(body)).map_err(ClientError::broken)?;
        let upload = async {
            let mut sent = 0;
            while sent < total {
                // Never more than was announced, should the file grow meanwhile.
                let mut part = Vec::with_capacity(PART_BYTES);
                let most = (total - sent).min(PART_BYTES as u64);
                let count = (&mut file).take(most).read_buf(&mut part).await.map_err(unreadable)?;
                if count == 0 {
                    return Err(unreadable(std::io::Error::other("the file became shorter while it was sent")));
                }
                let taken = async { Ok(parts.send(part.into()).await.is_ok()) };
                if !self.listener.patiently(Wait::Upload, &self.socket, taken).await? {
                    break; // The daemon has answered early; its answer says why.
                }
                sent += count as u64;
                progress(sent, total);
            }
            drop(parts);
            Ok(())
        };
        let exchange = exchange(&self.socket, request);
        tokio::pin!(upload, exchange);
        tokio::select! {
            // The daemon may refuse before everything is sent.
            answer = &mut exchange => return self.answer(answer?).await,
            uploaded = &mut upload => uploaded?,
        }
        self.answer(self.checked(exchange).await?).await
    }

    /// Waits for the end of the daemon's checks of a part that was sent. That it is alive shows in its status.
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
                    // Too busy for a question is alive.
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

    /// News from now on; the first is [`Event::Status`](crate::daemon::api::Event::Status).
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn events(&self) -> Result<Events, ClientError> {
        let request =
            request(Method::GET, "/v1/events").body(Either::Left(Full::default())).map_err(ClientError::broken)?;
        let conversation = async {
            let (response, connection) = exchange(&self.socket, request).await?;
            Ok((accepted(response).await?, connection))
        };
        let (response, connection) = self.listener.patiently(Wait::Query, &self.socket, conversation).await?;
        Ok(Events::new(response.into_body(), self.listener.clone(), connection))
    }
}
