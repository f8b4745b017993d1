//! The server of the daemon, and a printer made of a few lines that takes jobs, keeps their files and obeys orders at once.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use layerd::api::{DeviceView, Event, InDoubt, JobView, LinkState, LinkView, RaiseView, RemovedView};
use layerd::cli::client::{Client, NewJob};
use layerd::daemon::handle::{Answer, Desk, Order, OrderError, Snapshot, Ticket, channel};
use layerd::daemon::http::server;
use layerd::daemon::http::socket::{self};
use layerd::job::JobState;
use tokio::sync::watch;

/// Magic and version of a build file. What follows nobody reads here.
pub(crate) const BEGINNING: &[u8] = b"\x89LYD\r\n\x1a\n\x04\0\0\0";

/// A daemon without a machine: it takes jobs, keeps their files and obeys orders at once.
pub(crate) struct Daemon {
    pub(crate) directory: tempfile::TempDir,
    pub(crate) events: tokio::sync::broadcast::Sender<Event>,
    pub(crate) shutdown: watch::Sender<bool>,
    pub(crate) servers: [tokio::task::JoinHandle<()>; 2],
}

impl Daemon {
    pub(crate) async fn start() -> Self {
        Self::start_from(empty_snapshot()).await
    }

    /// Knows the jobs of this snapshot.
    pub(crate) async fn start_from(snapshot: Snapshot) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let incoming = directory.path().join("incoming");
        std::fs::create_dir(&incoming).unwrap();
        let [control, aborts] = socket::bind(&directory.path().join("control.sock")).await.unwrap();
        let (handle, desk) = channel(snapshot);
        let events = desk.events.clone();
        let (shutdown, ends) = watch::channel(false);
        let servers = [
            tokio::spawn(server::serve(control, handle.clone(), directory.path().into(), ends.clone())),
            tokio::spawn(server::serve_aborts(aborts, handle, ends)),
        ];
        tokio::spawn(obey(desk, directory.path().into()));
        Self { directory, events, shutdown, servers }
    }

    pub(crate) fn socket(&self) -> PathBuf {
        self.directory.path().join("control.sock")
    }

    pub(crate) fn abort_socket(&self) -> PathBuf {
        socket::abort_path(&self.socket())
    }

    pub(crate) fn client(&self) -> Client {
        Client::new(self.socket())
    }

    pub(crate) fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.directory.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    pub(crate) fn incoming_files(&self) -> usize {
        std::fs::read_dir(self.directory.path().join("incoming")).unwrap().count()
    }

    pub(crate) async fn submit(&self, name: &str) -> JobView {
        let part = self.file("part.layerd", &[BEGINNING, b"some bytes"].concat());
        self.client().submit(&NewJob { part, name: name.into(), recipe: None }, |_, _| {}).await.unwrap()
    }
}

pub(crate) fn empty_snapshot() -> Snapshot {
    Snapshot {
        machine: "test machine".into(),
        link: LinkView { state: LinkState::Connecting, path: "/dev/none".into(), device: None, reason: None },
        device: DeviceView::default(),
        budget: Default::default(),
        line: Default::default(),
        jobs_ended: 0,
        fit: None,
        jobs: Vec::new(),
    }
}

pub(crate) async fn obey(mut desk: Desk, directory: PathBuf) {
    while let Some(Ticket { order, reply }) = desk.orders.next().await {
        let mut answer = Err(OrderError::new(404, "no such job"));
        desk.snapshot.send_modify(|snapshot| answer = carry_out(order, snapshot, &directory));
        if let Ok(Answer::Job(job)) = &answer {
            let _ = desk.events.send(Event::Job(job.clone()));
        }
        let _ = reply.send(answer);
    }
}

pub(crate) fn carry_out(order: Order, snapshot: &mut Snapshot, directory: &Path) -> Result<Answer, OrderError> {
    let (id, state) = match order {
        Order::Submit(new) => {
            let id = format!("job-{}", snapshot.jobs.len() + 1);
            let text = new.recipe_text.unwrap_or_default();
            std::fs::write(directory.join(format!("{id}.toml")), text).unwrap();
            std::fs::rename(&*new.part, directory.join(format!("{id}.layerd"))).unwrap();
            snapshot.jobs.push(queued(&id, &new.name, new.recipe_name));
            return Ok(snapshot.jobs[snapshot.jobs.len() - 1].clone().into());
        }
        Order::Again(again) => {
            let old = snapshot.job(&again.id).cloned().ok_or_else(|| OrderError::new(404, "no such job"))?;
            let id = format!("job-{}", snapshot.jobs.len() + 1);
            std::fs::write(directory.join(format!("{id}.toml")), again.recipe_text.unwrap_or_default()).unwrap();
            snapshot.jobs.push(queued(&id, &old.name, again.recipe_name));
            return Ok(snapshot.jobs[snapshot.jobs.len() - 1].clone().into());
        }
        Order::Raise => return Ok(Answer::Raise(RaiseView { from_um: 3_200, to_um: 30_000, warning: None })),
        Order::Remove(id) => {
            let known = snapshot.jobs.len();
            snapshot.jobs.retain(|job| job.id != id);
            let removed = Answer::Removed(RemovedView { id, freed_bytes: 4096 });
            return if snapshot.jobs.len() < known { Ok(removed) } else { Err(OrderError::new(404, "no such job")) };
        }
        Order::Pause(id) => (id, JobState::Paused),
        Order::Resume { in_doubt: Some(InDoubt::Repeat), .. } => {
            return Err(OrderError::new(409, "nothing is in doubt"));
        }
        Order::Resume { id, .. } => (id, JobState::Printing),
        Order::Stop(id) => (id, JobState::Stopped),
        Order::Abort(Some(id)) => (id, JobState::Aborted),
        Order::Abort(None) => {
            let active = snapshot.active().ok_or_else(|| OrderError::new(409, "nothing is printing"))?;
            (active.id.clone(), JobState::Aborted)
        }
    };
    let job = snapshot.jobs.iter_mut().find(|job| job.id == id).ok_or_else(|| OrderError::new(404, "no such job"))?;
    job.state = state;
    Ok(job.clone().into())
}

pub(crate) fn queued(id: &str, name: &str, recipe: Option<String>) -> JobView {
    let recipe = recipe.unwrap_or_else(|| "default".into());
    JobView { name: name.into(), recipe, submitted_ms: 1, ..JobView::queued(id.into()) }
}

/// One raw HTTP exchange; the connection is closed by the daemon.
pub(crate) fn raw(socket: &Path, request: &[u8]) -> String {
    let mut stream = std::os::unix::net::UnixStream::connect(socket).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    // The daemon may answer and close before it has read everything.
    let _ = stream.write_all(request);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

pub(crate) async fn raw_async(socket: PathBuf, request: impl Into<Vec<u8>>) -> String {
    let request = request.into();
    tokio::task::spawn_blocking(move || raw(&socket, &request)).await.unwrap()
}

pub(crate) async fn wait_until(condition: impl Fn() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < Duration::from_secs(10), "waited in vain");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

pub(crate) async fn wait_until_async(condition: impl AsyncFn() -> bool) {
    let began = Instant::now();
    while !condition().await {
        assert!(began.elapsed() < Duration::from_secs(10), "waited in vain");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
