//! Connections: how many there may be, which one is closed for a new one, and which requests each may make.
//!
//! A connection is accepted at once, so that none waits in the socket's queue. The first [`MAX_CONNECTIONS`] may make every
//! request. All others may only abort; any other request is refused with 503. Of those there are at most [`MAX_ABORT_ONLY`]: a new
//! one replaces one that has sent no request yet, so that silent connections cannot keep an abort out. `tests/abort_crowd.rs` and
//! `tests/control_api/sockets.rs` test it.

use std::collections::HashMap;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::response::Response;
use hyper::Request;
use hyper::body::Incoming;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::{Instant, timeout};

use crate::daemon::caller::Caller;

/// Connections at once that may make every request. Operators, a web bridge and scripts need a handful.
pub(crate) const MAX_CONNECTIONS: usize = 64;
/// Connections at once that may only abort. An honest client sends its request within a millisecond. To lose its place before
/// that, 64 others must connect in the same millisecond.
pub(crate) const MAX_ABORT_ONLY: usize = 64;
/// A connection is closed if the head of its request takes longer. All clients are programs on this host.
pub(crate) const MAX_HEAD_TIME: Duration = Duration::from_secs(1);
/// Requests under way may take this much longer once the printer has ended.
const MAX_DRAIN_TIME: Duration = Duration::from_secs(1);
/// Pause after an accept that failed, as without file descriptors. Connections may end meanwhile.
const PAUSE: Duration = Duration::from_millis(20);
/// How often the log says that connections cannot be accepted.
const ERROR_LOG_INTERVAL: Duration = Duration::from_secs(1);

/// One socket and what it answers.
pub(crate) struct Listener {
    /// The socket.
    pub listener: UnixListener,
    /// Answers the first [`MAX_CONNECTIONS`]; with `None` every connection may only abort.
    pub everything: Option<Router>,
    /// Answers the connections that may only abort.
    pub aborts: Router,
    /// Longest head of a request, bytes; at least 8192.
    pub max_head_bytes: usize,
}

impl Listener {
    /// Serves the socket until `shutdown` becomes true or its sender is dropped.
    pub(crate) async fn serve(self, mut shutdown: watch::Receiver<bool>) {
        let Self { listener, everything, aborts, max_head_bytes } = self;
        let settings = HttpSettings { max_head_bytes, shutdown: shutdown.clone() };
        let places = Arc::new(Semaphore::new(if everything.is_some() { MAX_CONNECTIONS } else { 0 }));
        let everything = everything.map(TowerToHyperService::new);
        let mut abort_only = AbortOnly::new(aborts);
        let mut tasks = JoinSet::new();
        let mut logged: Option<Instant> = None;
        loop {
            while tasks.try_join_next().is_some() {}
            abort_only.count();
            let accepted = tokio::select! {
                () = ending(&mut shutdown) => break,
                accepted = listener.accept() => accepted,
            };
            let stream = match accepted {
                Ok((stream, _)) => stream,
                Err(error) => {
                    if logged.is_none_or(|at| at.elapsed() >= ERROR_LOG_INTERVAL) {
                        logged = Some(Instant::now());
                        tracing::warn!(%error, "cannot take a connection");
                    }
                    abort_only.make_room();
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
            };
            let caller = Caller::of(&stream);
            match (&everything, Arc::clone(&places).try_acquire_owned()) {
                (Some(everything), Ok(place)) => {
                    tasks.spawn(settings.clone().serve_one(stream, caller, everything.clone(), None, Some(place)));
                }
                _ => abort_only.admit(stream, caller, &settings),
            }
            // Lets the others run before the next one is accepted, and closes the one that was replaced.
            tokio::task::yield_now().await;
        }
        drop(listener);
        let drained = async {
            while tasks.join_next().await.is_some() {}
            while abort_only.tasks.join_next().await.is_some() {}
        };
        let _ = timeout(MAX_DRAIN_TIME, drained).await;
    }
}

/// Waits until the daemon ends.
pub(crate) async fn ending(shutdown: &mut watch::Receiver<bool>) {
    // An error means that the sender is gone, which is an end as well.
    let _ = shutdown.wait_for(|ends| *ends).await;
}

/// How to speak HTTP on a connection.
#[derive(Clone)]
struct HttpSettings {
    max_head_bytes: usize,
    shutdown: watch::Receiver<bool>,
}

impl HttpSettings {
    /// Serves one request. `asked` becomes true when it arrives; `_place` is held until the end.
    async fn serve_one(
        mut self,
        stream: UnixStream,
        caller: Caller,
        service: TowerToHyperService<Router>,
        asked: Option<Arc<AtomicBool>>,
        _place: Option<OwnedSemaphorePermit>,
    ) {
        let service = service_fn(move |mut request: Request<Incoming>| {
            if let Some(asked) = &asked {
                asked.store(true, Ordering::Relaxed);
            }
            request.extensions_mut().insert(caller);
            let answer = service.call(request);
            async move { Ok::<Response, Infallible>(answer.await.unwrap_or_else(|never| match never {})) }
        });
        let connection = hyper::server::conn::http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(MAX_HEAD_TIME)
            // One request a connection: a client that keeps sending without reading must not hold a place that another needs.
            .keep_alive(false)
            .max_buf_size(self.max_head_bytes)
            .serve_connection(TokioIo::new(stream), service);
        tokio::pin!(connection);
        let ended = tokio::select! {
            ended = &mut connection => ended,
            () = ending(&mut self.shutdown) => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        if let Err(error) = ended {
            tracing::debug!(%error, "a control connection ended early");
        }
    }
}

/// The connections that may only abort.
struct AbortOnly {
    service: TowerToHyperService<Router>,
    tasks: JoinSet<()>,
    /// Oldest first.
    members: Vec<Member>,
}

struct Member {
    task: AbortHandle,
    pid: Option<i32>,
    asked: Arc<AtomicBool>,
}

impl AbortOnly {
    fn new(aborts: Router) -> Self {
        Self { service: TowerToHyperService::new(aborts), tasks: JoinSet::new(), members: Vec::new() }
    }

    /// Forgets those that have ended.
    fn count(&mut self) {
        let mut ended = false;
        while self.tasks.try_join_next().is_some() {
            ended = true;
        }
        if ended {
            self.members.retain(|member| !member.task.is_finished());
        }
    }

    fn admit(&mut self, stream: UnixStream, caller: Caller, settings: &HttpSettings) {
        if self.members.len() >= MAX_ABORT_ONLY {
            self.make_room();
        }
        let asked = Arc::new(AtomicBool::new(false));
        let served = settings.clone().serve_one(stream, caller, self.service.clone(), Some(Arc::clone(&asked)), None);
        self.members.push(Member { task: self.tasks.spawn(served), pid: caller.pid, asked });
    }

    /// Closes one: the oldest of the process with the most members, preferring those that have sent no request.
    fn make_room(&mut self) {
        let mut counts = HashMap::new();
        for member in &self.members {
            *counts.entry(member.pid).or_insert(0_usize) += 1;
        }
        let asked = |member: &Member| member.asked.load(Ordering::Relaxed);
        let rank = |member: &Member| (!asked(member), counts[&member.pid]);
        let Some(highest) = self.members.iter().map(rank).max() else { return };
        if let Some(at) = self.members.iter().position(|member| rank(member) == highest) {
            self.members.remove(at).task.abort();
        }
    }
}
