//! One connection to the daemon: HTTP over its Unix socket, one request a connection.
//! `cli/client.rs` uses one for each request.

use std::path::Path;
use std::time::Duration;

use http_body_util::{BodyExt, Either, Full};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1;
use hyper::{Method, Request, Response, header};
use hyper_util::rt::TokioIo;
use serde::de::DeserializeOwned;
use tokio::net::UnixStream;
use tokio::time::sleep;

use crate::api::{ChannelBody, ErrorBody};
use crate::cli::client_error::ClientError;
use crate::daemon::http::socket::MAX_PATH_BYTES;

/// Largest answer, and largest single event, bytes. The API sends nothing larger; a wrong socket must not fill memory.
pub(super) const MAX_ANSWER_BYTES: usize = 16 << 20;
/// How often connecting to a socket whose backlog is full is tried again.
const CONNECT_INTERVAL: Duration = Duration::from_millis(20);

/// A small body, or a build file piece by piece.
pub(super) type RequestBody = Either<Full<Bytes>, ChannelBody>;

/// A response and the connection that it comes through.
pub(super) type Answer = (Response<Incoming>, Connection);

/// The task that moves a connection's bytes. Dropping it closes the connection.
#[derive(Debug)]
pub(super) struct Connection(tokio::task::JoinHandle<()>);

impl Drop for Connection {
    fn drop(&mut self) {
        self.0.abort();
    }
}

async fn connect(socket: &Path) -> Result<UnixStream, ClientError> {
    loop {
        let source = match UnixStream::connect(socket).await {
            Ok(stream) => return Ok(stream),
            Err(source) => source,
        };
        return Err(match source.kind() {
            // The backlog is full: a process listens. The time limit is the caller's.
            std::io::ErrorKind::WouldBlock => {
                sleep(CONNECT_INTERVAL).await;
                continue;
            }
            std::io::ErrorKind::PermissionDenied => ClientError::NotAllowed { socket: socket.into(), source },
            std::io::ErrorKind::InvalidInput if socket.as_os_str().len() > MAX_PATH_BYTES => {
                ClientError::SocketPath { socket: socket.into() }
            }
            _ => ClientError::NoDaemon { socket: socket.into(), source },
        });
    }
}

/// Opens a connection and sends one request; returns with the head of its response.
pub(super) async fn exchange(socket: &Path, request: Request<RequestBody>) -> Result<Answer, ClientError> {
    let stream = connect(socket).await?;
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await.map_err(ClientError::broken)?;
    let connection = Connection(tokio::spawn(async move {
        // An error here also shows in the answer.
        let _ = connection.await;
    }));
    let response = sender.send_request(request).await.map_err(ClientError::broken)?;
    Ok((response, connection))
}

/// The beginning of a request.
pub(super) fn request(method: Method, path: &str) -> hyper::http::request::Builder {
    Request::builder().method(method).uri(path).header(header::HOST, "layerd")
}

/// A POST with a JSON body.
pub(super) fn post(path: &str, body: Bytes) -> Result<Request<RequestBody>, ClientError> {
    let request = request(Method::POST, path).header(header::CONTENT_TYPE, "application/json");
    request.body(Either::Left(Full::new(body))).map_err(ClientError::broken)
}

async fn bytes(response: Response<Incoming>) -> Result<Bytes, ClientError> {
    let limited = http_body_util::Limited::new(response.into_body(), MAX_ANSWER_BYTES);
    Ok(limited.collect().await.map_err(ClientError::broken)?.to_bytes())
}

/// The response if its status is success, else its error.
pub(super) async fn accepted(response: Response<Incoming>) -> Result<Response<Incoming>, ClientError> {
    let status = response.status();
    if status.is_success() {
        return Ok(response);
    }
    let bytes = bytes(response).await?;
    let message = match serde_json::from_slice::<ErrorBody>(&bytes) {
        Ok(body) => body.error,
        Err(_) => format!("the daemon answered {status}"),
    };
    Err(ClientError::Refused { status: status.as_u16(), message })
}

/// The answer of a request, from JSON.
pub(super) async fn read<T: DeserializeOwned>((response, _connection): Answer) -> Result<T, ClientError> {
    let bytes = bytes(accepted(response).await?).await?;
    serde_json::from_slice(&bytes).map_err(|error| {
        ClientError::Broken(format!("its answer is not understood ({error}); are layerd and layerctl of one version?"))
    })
}
