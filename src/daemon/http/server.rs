//! The control API: HTTP and JSON on a Unix socket, with server-sent events. A second socket beside it takes only aborts.
//! There is no log-in: a user who may open a socket may print. `tests/control_api` tries all of it.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, HttpBody as _};
use axum::extract::{Extension, FromRequestParts, Path as UrlPath, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::de::DeserializeOwned;
use tokio::net::UnixListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, broadcast, mpsc, watch};
use tokio::time::timeout;

use super::connections::{Listener, MAX_ABORT_ONLY, MAX_CONNECTIONS, MAX_HEAD_TIME, ending};
use super::{job_log, upload};
use crate::api::{ChannelBody, ErrorBody, Event, JobList, ResumeBody};
use crate::daemon::caller::Caller;
use crate::daemon::error::{OrderError, no_such_job};
use crate::daemon::handle::{Again, Handle, Order};
use crate::job::{JobDirectory, Spool};

/// Subscribers to events at once. Fewer than connections, so that they leave room for orders.
const MAX_SUBSCRIBERS: usize = 24;
/// Uploads at once. Each holds a file in the spool.
const MAX_UPLOADS: usize = 2;
/// Logs of jobs that are read at once. Each holds a thread while its reader takes its time, as a pager does.
const MAX_LOGS: usize = 8;
/// Head of a request, bytes. It may carry a recipe of 16 KiB, which is up to 48 KiB percent-encoded.
const MAX_HEAD_BYTES: usize = 64 << 10;
/// Head of a request on the socket for aborts, bytes. The least that hyper allows.
const MAX_ABORT_HEAD_BYTES: usize = 8 << 10;
/// JSON body of an order, bytes.
const MAX_ORDER_BYTES: usize = 4 << 10;
/// A subscriber gets at least a comment this often, so that both ends notice a broken connection.
const KEEP_ALIVE: Duration = Duration::from_secs(1);
/// File descriptors that both sockets use at most: their connections, and for each socket one connection that is being closed.
pub(crate) const MAX_DESCRIPTORS: u64 = (MAX_CONNECTIONS + 2 * (MAX_ABORT_ONLY + 1)) as u64;

/// Serves the API until `shutdown` becomes true or its sender is dropped. Uploads are written to the spool's `incoming`; opening the
/// spool removes what a crash left there. Logs are read from its journals.
pub async fn serve(listener: UnixListener, handle: Handle, spool: PathBuf, shutdown: watch::Receiver<bool>) {
    let shared = Shared {
        handle,
        spool,
        subscribers: Arc::new(Semaphore::new(MAX_SUBSCRIBERS)),
        uploads: Arc::new(Semaphore::new(MAX_UPLOADS)),
        logs: Arc::new(Semaphore::new(MAX_LOGS)),
        shutdown: shutdown.clone(),
    };
    let shared = Arc::new(shared);
    let everything = Some(router(Arc::clone(&shared)));
    let aborts = abort_router(shared.handle.clone(), no_place);
    Listener { listener, everything, aborts, max_head_bytes: MAX_HEAD_BYTES }.serve(shutdown).await;
}

/// Serves the socket for aborts until `shutdown` becomes true or its sender is dropped.
pub async fn serve_aborts(listener: UnixListener, handle: Handle, shutdown: watch::Receiver<bool>) {
    let aborts = abort_router(handle, only_aborts);
    let max_head_bytes = MAX_ABORT_HEAD_BYTES;
    Listener { listener, everything: None, aborts, max_head_bytes }.serve(shutdown).await;
}

struct Shared {
    handle: Handle,
    spool: PathBuf,
    subscribers: Arc<Semaphore>,
    uploads: Arc<Semaphore>,
    logs: Arc<Semaphore>,
    shutdown: watch::Receiver<bool>,
}

impl Shared {
    /// Reserves a place for an upload if the queue has room for it and for the uploads under way.
    fn begin_upload(&self) -> Result<OwnedSemaphorePermit, OrderError> {
        let place = Arc::clone(&self.uploads)
            .try_acquire_owned()
            .map_err(|_| OrderError::new(503, format!("{MAX_UPLOADS} uploads are under way already; try again")))?;
        let others = MAX_UPLOADS - 1 - self.uploads.available_permits();
        self.handle.snapshot().check_queue(others)?;
        Ok(place)
    }
}

type App = State<Arc<Shared>>;
type Answer = Result<Response, OrderError>;

/// Routes for aborts alone; `otherwise` answers everything else.
fn abort_router<F>(handle: Handle, otherwise: fn(Body) -> F) -> Router
where
    F: Future<Output = OrderError> + Send + 'static,
{
    Router::new()
        .route("/v1/abort", post(abort_active))
        .route("/v1/jobs/{id}/abort", post(abort_job))
        .fallback(otherwise)
        .method_not_allowed_fallback(otherwise)
        .with_state(handle)
}

fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/v1/status", get(status))
        .route("/v1/jobs", get(jobs).post(submit))
        .route("/v1/jobs/{id}", get(job).delete(remove))
        .route("/v1/jobs/{id}/log", get(log))
        .route("/v1/jobs/{id}/again", post(again))
        .route("/v1/jobs/{id}/{order}", post(order_job))
        .route("/v1/abort", post(abort))
        .route("/v1/raise", post(raise))
        .route("/v1/device", get(device))
        .route("/v1/events", get(events))
        .fallback(no_such_path)
        .method_not_allowed_fallback(no_such_method)
        .with_state(shared)
}

impl IntoResponse for OrderError {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        (status, Json(ErrorBody { error: self.message })).into_response()
    }
}

/// What the path names. A path that is not UTF-8 is refused with JSON, as every other mistake is.
struct Named<T>(T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for Named<T> {
    type Rejection = OrderError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, OrderError> {
        let UrlPath(named) = UrlPath::from_request_parts(parts, state).await.map_err(|rejection| {
            let path = parts.uri.path();
            OrderError::new(
                rejection.status().as_u16(),
                format!("the path {path} cannot be read: {}", rejection.body_text()),
            )
        })?;
        Ok(Self(named))
    }
}

async fn status(State(shared): App) -> Response {
    Json(shared.handle.snapshot().status()).into_response()
}

async fn jobs(State(shared): App) -> Response {
    Json(JobList { jobs: shared.handle.snapshot().jobs.clone() }).into_response()
}

async fn job(State(shared): App, Named(id): Named<String>) -> Answer {
    let found = shared.handle.snapshot().job(&id).cloned();
    found.map(|job| Json(job).into_response()).ok_or_else(|| no_such_job(&id))
}

async fn log(State(shared): App, Named(id): Named<String>) -> Answer {
    let number = shared.handle.snapshot().job(&id).and_then(|job| job.id.parse().ok());
    let number = number.ok_or_else(|| no_such_job(&id))?;
    let place = Arc::clone(&shared.logs)
        .try_acquire_owned()
        .map_err(|_| OrderError::new(503, format!("{MAX_LOGS} logs are being read already; try again")))?;
    job_log::answer(JobDirectory::of(&shared.spool, number).journal(), place).await
}

async fn again(
    State(shared): App,
    Extension(caller): Extension<Caller>,
    Named(id): Named<String>,
    headers: HeaderMap,
    body: Body,
) -> Answer {
    if !body.is_end_stream() {
        let message = "the part is already in the spool: send no body, or POST a build file to /v1/jobs";
        return Err(OrderError::new(400, message));
    }
    let (recipe_text, recipe_name) = upload::recipe(&headers)?;
    let jobs_ended = shared.handle.snapshot().jobs_ended;
    // Held until the job is in the queue, as for one that is uploaded.
    let _place = shared.begin_upload()?;
    let again = Again { id, recipe_text, recipe_name, jobs_ended };
    let job = shared.handle.order(Order::Again(again), caller).await?;
    Ok((StatusCode::CREATED, Json(job)).into_response())
}

async fn device(State(shared): App) -> Response {
    Json(shared.handle.snapshot().device.clone()).into_response()
}

async fn submit(
    State(shared): App,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    mut body: Body,
) -> Answer {
    let (jobs_ended, fit) = {
        let snapshot = shared.handle.snapshot();
        (snapshot.jobs_ended, snapshot.fit.clone())
    };
    let received = match shared.begin_upload() {
        // Held until the job is in the queue: several uploads together cannot overfill it.
        Ok(place) => {
            upload::receive(&Spool::incoming_of(&shared.spool), &headers, &mut body, jobs_ended, fit, place).await
        }
        Err(refusal) => Err(refusal),
    };
    let (submission, _place) = match received {
        Ok(received) => received,
        Err(refusal) => {
            upload::drain(&mut body).await;
            return Err(refusal);
        }
    };
    let job = shared.handle.order(Order::Submit(submission), caller).await?;
    Ok((StatusCode::CREATED, Json(job)).into_response())
}

async fn order_job(
    State(shared): App,
    Extension(caller): Extension<Caller>,
    Named((id, order)): Named<(String, String)>,
    request: Request,
) -> Answer {
    let jobs_ended = shared.handle.snapshot().jobs_ended;
    let order = match order.as_str() {
        "pause" => Order::Pause(id),
        "resume" => Order::Resume { id, in_doubt: resume_body(request).await?.in_doubt, jobs_ended },
        "stop" => Order::Stop(id),
        "abort" => Order::Abort(Some(id)),
        _ => {
            let message = format!("there is no order `{order}`; a job takes pause, resume, stop, abort and again");
            return Err(OrderError::new(404, message));
        }
    };
    Ok(Json(shared.handle.order(order, caller).await?).into_response())
}

async fn abort(State(shared): App, caller: Extension<Caller>) -> Answer {
    abort_active(State(shared.handle.clone()), caller).await
}

async fn abort_active(State(handle): State<Handle>, Extension(caller): Extension<Caller>) -> Answer {
    Ok(Json(handle.order(Order::Abort(None), caller).await?).into_response())
}

async fn abort_job(
    State(handle): State<Handle>,
    Extension(caller): Extension<Caller>,
    Named(id): Named<String>,
) -> Answer {
    Ok(Json(handle.order(Order::Abort(Some(id)), caller).await?).into_response())
}

async fn no_place(mut body: Body) -> OrderError {
    upload::drain(&mut body).await;
    OrderError::new(503, format!("{MAX_CONNECTIONS} connections are open already; only an abort is accepted now"))
}

async fn only_aborts(mut body: Body) -> OrderError {
    upload::drain(&mut body).await;
    let message = "this socket takes only POST /v1/abort and POST /v1/jobs/{id}/abort; use the one without `.abort`";
    OrderError::new(404, message)
}

async fn remove(State(shared): App, Extension(caller): Extension<Caller>, Named(id): Named<String>) -> Answer {
    Ok(Json(shared.handle.order(Order::Remove(id), caller).await?).into_response())
}

async fn raise(State(shared): App, Extension(caller): Extension<Caller>) -> Answer {
    Ok(Json(shared.handle.order(Order::Raise, caller).await?).into_response())
}

async fn resume_body(request: Request) -> Result<ResumeBody, OrderError> {
    let read = timeout(MAX_HEAD_TIME, axum::body::to_bytes(request.into_body(), MAX_ORDER_BYTES));
    let bytes = read
        .await
        .map_err(|_| OrderError::new(408, "the body did not arrive"))?
        .map_err(|error| OrderError::new(400, format!("the body cannot be read: {error}")))?;
    if bytes.is_empty() {
        return Ok(ResumeBody::default());
    }
    serde_json::from_slice(&bytes).map_err(|error| {
        OrderError::new(
            400,
            format!("the body is not {{\"in_doubt\": \"exposed\"}} or {{\"in_doubt\": \"repeat\"}}: {error}"),
        )
    })
}

async fn no_such_path(uri: Uri) -> OrderError {
    OrderError::new(404, format!("there is no path {}; docs/control-api.md lists all paths", uri.path()))
}

async fn no_such_method(method: Method, uri: Uri) -> OrderError {
    OrderError::new(405, format!("{} does not allow {method}; docs/control-api.md lists what it allows", uri.path()))
}

async fn events(State(shared): App) -> Answer {
    let Ok(permit) = Arc::clone(&shared.subscribers).try_acquire_owned() else {
        return Err(OrderError::new(503, format!("{MAX_SUBSCRIBERS} subscribers listen already")));
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
