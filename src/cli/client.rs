//! The control API as `layerctl` and other programs call it.

mod connection;
mod events;
mod log;
mod submit;

use std::path::{Path, PathBuf};

use http_body_util::{Either, Full};
use hyper::body::Bytes;
use hyper::{Method, Request};
use serde::de::DeserializeOwned;

use self::connection::{Answer, RequestBody, accepted, exchange, post, read, request};
pub use self::events::Events;
pub use self::log::Log;
pub use self::submit::NewJob;
pub use super::client_error::ClientError;
use super::patience::{Listener, Wait};
use crate::api::percent;
use crate::api::{JobList, JobView, RaiseView, RemovedView, ResumeBody, Status};
use crate::config::DEFAULT_SOCKET;
use crate::daemon::http::socket;

/// How often an abort is tried: on a crowded socket the daemon may close a connection before it has read the request.
const MAX_ABORT_TRIES: usize = 3;

/// A client of the daemon. Each request opens a connection of its own.
#[derive(Clone, Debug)]
pub struct Client {
    socket: PathBuf,
    listener: Listener,
}

impl Client {
    /// A client for the socket of `--socket`, else of `$LAYERD_SOCKET`, else [`DEFAULT_SOCKET`]. Long waits are reported on stderr.
    pub fn from_environment() -> Self {
        let of_environment = || std::env::var_os("LAYERD_SOCKET").filter(|path| !path.is_empty()).map(PathBuf::from);
        let socket = super::NAMED_SOCKET.get().cloned().or_else(of_environment);
        Self::new(socket.unwrap_or_else(|| DEFAULT_SOCKET.into())).telling(super::eprint)
    }

    /// A client for the daemon at `socket`. Waits are not reported.
    pub fn new(socket: impl Into<PathBuf>) -> Self {
        Self { socket: socket.into(), listener: Listener::new(|_| {}) }
    }

    /// Calls `hear` with what the client waits for, if that takes longer than two seconds.
    #[must_use]
    pub fn telling(self, hear: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self { listener: Listener::new(hear), ..self }
    }

    /// The socket.
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// The daemon's status.
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
    /// [`ClientError`]; status 404 if there is none.
    pub async fn job(&self, id: &str) -> Result<JobView, ClientError> {
        self.get(&format!("/v1/jobs/{}", percent::encode(id))).await
    }

    /// Reads `path`, such as `/v1/device`.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, ClientError> {
        self.get_within(Wait::Query, path).await
    }

    /// Reads `path` for an order that depends on the answer. Waits as long as for an order; an error says that the order was not
    /// given.
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
    /// [`ClientError`]; status 409 if the job's state does not allow it.
    pub async fn order(&self, id: &str, order: &str) -> Result<JobView, ClientError> {
        let path = format!("/v1/jobs/{}/{order}", percent::encode(id));
        if order == "abort" { self.post_abort(&path).await } else { self.post(Wait::Order, &path, Bytes::new()).await }
    }

    /// Resumes a paused or interrupted job, or confirms for a queued one that the plate is empty.
    ///
    /// # Errors
    /// [`ClientError`]; status 409 if a layer is in doubt and `body` does not say what happened to it.
    pub async fn resume(&self, id: &str, body: ResumeBody) -> Result<JobView, ClientError> {
        let bytes = serde_json::to_vec(&body).map_err(ClientError::broken)?;
        self.post(Wait::Order, &format!("/v1/jobs/{}/resume", percent::encode(id)), bytes.into()).await
    }

    /// Aborts the job that holds the machine; the light goes off even if there is none.
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn abort_active(&self) -> Result<JobView, ClientError> {
        self.post_abort("/v1/abort").await
    }

    /// Sends an abort to the socket for aborts; to the main socket if that one cannot be used. An abort that arrives twice does no
    /// harm.
    async fn post_abort(&self, path: &str) -> Result<JobView, ClientError> {
        let aborts = Self { socket: socket::abort_path(&self.socket), ..self.clone() };
        let conversation = async {
            for _ in 0..MAX_ABORT_TRIES {
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
    /// [`ClientError`]; status 409 if a job has the machine or the plate cannot be moved.
    pub async fn raise(&self) -> Result<RaiseView, ClientError> {
        self.post(Wait::Order, "/v1/raise", Bytes::new()).await
    }

    /// Deletes a job that is over.
    ///
    /// # Errors
    /// [`ClientError`]; status 409 if the job is not over.
    pub async fn remove(&self, id: &str) -> Result<RemovedView, ClientError> {
        let request = request(Method::DELETE, &format!("/v1/jobs/{}", percent::encode(id)));
        let request = request.body(Either::Left(Full::default())).map_err(ClientError::broken)?;
        self.ask(Wait::Order, request).await
    }

    async fn post<T: DeserializeOwned>(&self, wait: Wait, path: &str, body: Bytes) -> Result<T, ClientError> {
        self.ask(wait, post(path, body)?).await
    }

    async fn ask<T: DeserializeOwned>(&self, wait: Wait, request: Request<RequestBody>) -> Result<T, ClientError> {
        self.listener.patiently(wait, &self.socket, self.ask_once(request)).await
    }

    /// Sends a request and reads the answer, without a time limit.
    async fn ask_once<T: DeserializeOwned>(&self, request: Request<RequestBody>) -> Result<T, ClientError> {
        read(exchange(&self.socket, request).await?).await
    }

    /// The log of a job, from its journal.
    ///
    /// # Errors
    /// [`ClientError`]; status 404 if there is no such job.
    pub async fn log(&self, id: &str) -> Result<Log, ClientError> {
        let (response, connection) = self.stream(&format!("/v1/jobs/{}/log", percent::encode(id))).await?;
        Ok(Log::new(self.clone(), response.into_body(), connection))
    }

    /// Events from now on; the first is [`Event::Status`](crate::api::Event::Status).
    ///
    /// # Errors
    /// [`ClientError`].
    pub async fn events(&self) -> Result<Events, ClientError> {
        let (response, connection) = self.stream("/v1/events").await?;
        Ok(Events::new(response.into_body(), self.listener.clone(), connection))
    }

    /// Asks for an answer that comes piece by piece.
    async fn stream(&self, path: &str) -> Result<Answer, ClientError> {
        let request = request(Method::GET, path).body(Either::Left(Full::default())).map_err(ClientError::broken)?;
        let conversation = async {
            let (response, connection) = exchange(&self.socket, request).await?;
            Ok((accepted(response).await?, connection))
        };
        self.listener.patiently(Wait::Query, &self.socket, conversation).await
    }
}
