//! The control API: HTTP and JSON on a Unix socket, events as server-sent events. Whoever may open the socket may print.

use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::extract::{Path as UrlPath, Request, State};
use axum::http::{HeaderMap, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, broadcast, mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::api::{ErrorBody, Event, JobList, ResumeBody};
use super::handle::{Command, CommandError, Handle};
use super::{ChannelBody, upload};

/// Connections at once; more wait in the socket's backlog. Operators, a web bridge and scripts need a handful.
const MOST_CONNECTIONS: usize = 64;
/// Subscribers to events at once; fewer than connections, so that they can never keep an abort out.
const MOST_SUBSCRIBERS: usize = 24;
/// Uploads at once: each holds a file in the spool.
const MOST_UPLOADS: usize = 2;
/// All headers together, bytes: a recipe of 16 KiB is 48 KiB percent-encoded.
const LARGEST_HEAD_BYTES: usize = 64 << 10;
/// A client that does not finish a request's head, or that keeps a connection without asking anything, is let go.
const LONGEST_HEAD: Duration = Duration::from_secs(10);
/// A small JSON body, bytes.
const LARGEST_ORDER_BYTES: usize = 4 << 10;
/// A subscriber hears at least this often, so that both ends notice a broken connection.
const KEEP_ALIVE: Duration = Duration::from_secs(1);
/// Requests under way get this long to end once the printer has ended.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Why the socket cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum BindError {
    /// Somebody answers there.
    #[error("another layerd already serves {}: stop it first, or give this one another `socket`", .0.display())]
    AlreadyRunning(PathBuf),
    /// Something else is in the way.
    #[error("{} exists and is not a socket: remove it, or give layerd another `socket`", .0.display())]
    NotASocket(PathBuf),
    /// The system refused.
    #[error("cannot serve the control socket {}: {source} (does the directory exist, and may this user write there?)", path.display())]
    Io {
        /// The socket.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// Opens the control socket with mode 0660. A socket that nobody serves any more is replaced.
///
/// # Errors
/// [`BindError`] says what is in the way.
pub async fn bind(path: &Path) -> Result<UnixListener, BindError> {
    let io = |source| BindError::Io { path: path.into(), source };
    match std::fs::symlink_metadata(path) {
        Ok(found) if !found.file_type().is_socket() => return Err(BindError::NotASocket(path.into())),
        Ok(_) if UnixStream::connect(path).await.is_ok() => return Err(BindError::AlreadyRunning(path.into())),
        Ok(_) => tracing::info!(socket = %path.display(), "replacing a socket that nobody serves"),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
        Err(error) => return Err(io(error)),
    }
    // Under another name until its mode is right, then renamed over what is there: never open to all, never missing.
    let mut new = path.as_os_str().to_owned();
    new.push(format!(".{}", std::process::id()));
    let new = PathBuf::from(new);
    let _ = std::fs::remove_file(&new);
    let listener = UnixListener::bind(&new).map_err(io)?;
    std::fs::set_permissions(&new, std::fs::Permissions::from_mode(0o660)).map_err(io)?;
    std::fs::rename(&new, path).map_err(io)?;
    Ok(listener)
}

/// Serves the API until `shutdown` becomes true (or its sender is dropped). `incoming` takes uploads; it
/// must lie on the spool's file system, and whoever opens the spool removes what a crash left there.
pub async fn serve(listener: UnixListener, handle: Handle, incoming: PathBuf, mut shutdown: watch::Receiver<bool>) {
    let shared = Shared {
        handle,
        incoming,
        subscribers: Arc::new(Semaphore::new(MOST_SUBSCRIBERS)),
        uploads: Semaphore::new(MOST_UPLOADS),
        shutdown: shutdown.clone(),
    };
    let service = TowerToHyperService::new(router(Arc::new(shared)));
    let connections = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    let mut tasks = JoinSet::new();
    loop {
        while tasks.try_join_next().is_some() {}
        let accepted = tokio::select! {
            () = ending(&mut shutdown) => break,
            accepted = accept(&listener, &connections) => accepted,
        };
        let (stream, permit) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                // Out of file descriptors: wait for connections to end instead of spinning.
                tracing::warn!(%error, "cannot accept a connection");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        tasks.spawn(converse(stream, service.clone(), shutdown.clone(), permit));
    }
    drop(listener);
    let _ = timeout(LAST_WORDS, async { while tasks.join_next().await.is_some() {} }).await;
}

async fn accept(
    listener: &UnixListener,
    connections: &Arc<Semaphore>,
) -> std::io::Result<(UnixStream, OwnedSemaphorePermit)> {
    let permit = Arc::clone(connections).acquire_owned().await.map_err(std::io::Error::other)?;
    let (stream, _) = listener.accept().await?;
    Ok((stream, permit))
}

async fn converse(
    stream: UnixStream,
    service: TowerToHyperService<Router>,
    mut shutdown: watch::Receiver<bool>,
    _permit: OwnedSemaphorePermit,
) {
    let connection = hyper::server::conn::http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(LONGEST_HEAD)
        // One request a connection: a client that asks on without reading must not hold a place that an abort needs.
        .keep_alive(false)
        .max_buf_size(LARGEST_HEAD_BYTES)
        .serve_connection(TokioIo::new(stream), service);
    tokio::pin!(connection);
    let ended = tokio::select! {
        ended = &mut connection => ended,
        () = ending(&mut shutdown) => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a control connection ended early");
    }
}

/// Waits for the end of the daemon.
async fn ending(shutdown: &mut watch::Receiver<bool>) {
    // An error means that the sender is gone, which is an end as well.
    let _ = shutdown.wait_for(|ends| *ends).await;
}

struct Shared {
    handle: Handle,
    incoming: PathBuf,
    subscribers: Arc<Semaphore>,
    uploads: Semaphore,
    shutdown: watch::Receiver<bool>,
}

type App = State<Arc<Shared>>;
type Answer = Result<Response, CommandError>;

fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/v1/status", get(status))
        .route("/v1/jobs", get(jobs).post(submit))
        .route("/v1/jobs/{id}", get(job))
        .route("/v1/jobs/{id}/{order}", post(order_job))
        .route("/v1/abort", post(abort))
        .route("/v1/device", get(device))
        .route("/v1/events", get(events))
        .fallback(no_such_path)
        .method_not_allowed_fallback(no_such_method)
        .with_state(shared)
}

impl IntoResponse for CommandError {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        (status, Json(ErrorBody { error: self.message })).into_response()
    }
}

async fn status(State(shared): App) -> Response {
    Json(shared.handle.snapshot().status()).into_response()
}

async fn jobs(State(shared): App) -> Response {
    Json(JobList { jobs: shared.handle.snapshot().jobs.clone() }).into_response()
}

async fn job(State(shared): App, UrlPath(id): UrlPath<String>) -> Answer {
    let found = shared.handle.snapshot().job(&id).cloned();
    found
        .map(|job| Json(job).into_response())
        .ok_or_else(|| CommandError::new(404, format!("there is no job `{id}`; `layerctl jobs` lists them")))
}

async fn device(State(shared): App) -> Response {
    Json(shared.handle.snapshot().device.clone()).into_response()
}

async fn submit(State(shared): App, headers: HeaderMap, mut body: Body) -> Answer {
    let jobs_ended = shared.handle.snapshot().jobs_ended;
    let submission = match shared.uploads.try_acquire() {
        Ok(_permit) => upload::receive(&shared.incoming, &headers, &mut body, jobs_ended).await,
        Err(_) => Err(CommandError::new(503, format!("{MOST_UPLOADS} uploads are under way already; try again"))),
    };
    let submission = match submission {
        Ok(submission) => submission,
        Err(refusal) => {
            upload::drain(&mut body).await;
            return Err(refusal);
        }
    };
    let job = shared.handle.order(Command::Submit(submission)).await?;
    Ok((StatusCode::CREATED, Json(job)).into_response())
}

async fn order_job(State(shared): App, UrlPath((id, order)): UrlPath<(String, String)>, request: Request) -> Answer {
    let command = match order.as_str() {
        "pause" => Command::Pause(id),
        "resume" => Command::Resume { id, in_doubt: resume_body(request).await?.in_doubt },
        "stop" => Command::Stop(id),
        "abort" => Command::Abort(Some(id)),
        _ => {
            let message = format!("there is no order `{order}`; a job takes pause, resume, stop and abort");
            return Err(CommandError::new(404, message));
        }
    };
    Ok(Json(shared.handle.order(command).await?).into_response())
}

async fn abort(State(shared): App) -> Answer {
    Ok(Json(shared.handle.order(Command::Abort(None)).await?).into_response())
}

async fn resume_body(request: Request) -> Result<ResumeBody, CommandError> {
    let read = timeout(LONGEST_HEAD, axum::body::to_bytes(request.into_body(), LARGEST_ORDER_BYTES));
    let bytes = read
        .await
        .map_err(|_| CommandError::new(408, "the body did not arrive"))?
        .map_err(|error| CommandError::new(400, format!("the body cannot be read: {error}")))?;
    if bytes.is_empty() {
        return Ok(ResumeBody::default());
    }
    serde_json::from_slice(&bytes).map_err(|error| {
        CommandError::new(
            400,
            format!("the body is not {{\"in_doubt\": \"exposed\"}} or {{\"in_doubt\": \"repeat\"}}: {error}"),
        )
    })
}

async fn no_such_path(uri: Uri) -> CommandError {
    CommandError::new(404, format!("there is no {}; docs/control-api.md lists what there is", uri.path()))
}

async fn no_such_method(method: Method, uri: Uri) -> CommandError {
    CommandError::new(405, format!("{} does not take {method}; docs/control-api.md lists what it takes", uri.path()))
}

async fn events(State(shared): App) -> Answer {
    let Ok(permit) = Arc::clone(&shared.subscribers).try_acquire_owned() else {
        return Err(CommandError::new(503, format!("{MOST_SUBSCRIBERS} subscribers listen already")));
    };
    // Subscribed before the status is read: nothing falls between the two.
    let news = shared.handle.subscribe();
    let first = Event::Status(Box::new(shared.handle.snapshot().status()));
    let (parts, body) = ChannelBody::new();
    tokio::spawn(tell(first, news, parts, shared.shutdown.clone(), permit));
    let headers = [(header::CONTENT_TYPE, "text/event-stream"), (header::CACHE_CONTROL, "no-store")];
    Ok((headers, Body::new(body)).into_response())
}

/// Writes events to one subscriber until it or the daemon ends.
async fn tell(
    first: Event,
    mut news: broadcast::Receiver<Event>,
    parts: mpsc::Sender<hyper::body::Bytes>,
    mut shutdown: watch::Receiver<bool>,
    _permit: OwnedSemaphorePermit,
) {
    let mut part = server_sent(&first);
    loop {
        // A subscriber that stops reading holds its connection only until the daemon ends or it hangs up.
        tokio::select! {
            sent = parts.send(part.into()) => if sent.is_err() { return },
            () = ending(&mut shutdown) => return,
        }
        part = tokio::select! {
            heard = timeout(KEEP_ALIVE, news.recv()) => match heard {
                Ok(Ok(event)) => server_sent(&event),
                Ok(Err(broadcast::error::RecvError::Lagged(missed))) => server_sent(&Event::Lagged { missed }),
                Ok(Err(broadcast::error::RecvError::Closed)) => return,
                Err(_) => ": still here\n\n".into(),
            },
            () = parts.closed() => return,
            () = ending(&mut shutdown) => return,
        };
    }
}

fn server_sent(event: &Event) -> String {
    let data = serde_json::to_string(event).expect("an event is plain data");
    format!("event: {}\ndata: {data}\n\n", event.name())
}
