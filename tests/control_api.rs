//! The control API over a real Unix socket: the server of the daemon, the client of `layerctl`, and a printer made of a few
//! lines in between.

#![allow(clippy::unwrap_used, reason = "a test may fail by panicking, helpers included")]

use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use layerd::api::{DeviceView, Event, InDoubt, JobView, LinkState, LinkView, RaiseView, RemovedView, ResumeBody};
use layerd::cli::client::{Client, ClientError, NewJob};
use layerd::daemon::caller::Caller;
use layerd::daemon::handle::{Answer, Command, CommandError, Desk, MAX_QUEUED_JOBS, Order, Snapshot, channel};
use layerd::daemon::http::server;
use layerd::daemon::http::socket::{self, BindError};
use layerd::job::JobState;
use tokio::sync::watch;

/// Magic and version of a build file. What follows nobody reads here.
const BEGINNING: &[u8] = b"\x89LYD\r\n\x1a\n\x03\0\0\0";

/// A daemon without a machine: it takes jobs, keeps their files and obeys orders at once.
struct Daemon {
    directory: tempfile::TempDir,
    events: tokio::sync::broadcast::Sender<Event>,
    shutdown: watch::Sender<bool>,
    servers: [tokio::task::JoinHandle<()>; 2],
}

impl Daemon {
    async fn start() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let incoming = directory.path().join("incoming");
        std::fs::create_dir(&incoming).unwrap();
        let [control, aborts] = socket::bind(&directory.path().join("control.sock")).await.unwrap();
        let (handle, desk) = channel(empty_snapshot());
        let events = desk.events.clone();
        let (shutdown, ends) = watch::channel(false);
        let servers = [
            tokio::spawn(server::serve(control, handle.clone(), incoming, ends.clone())),
            tokio::spawn(server::serve_aborts(aborts, handle, ends)),
        ];
        tokio::spawn(obey(desk, directory.path().into()));
        Self { directory, events, shutdown, servers }
    }

    fn socket(&self) -> PathBuf {
        self.directory.path().join("control.sock")
    }

    fn abort_socket(&self) -> PathBuf {
        socket::abort_path(&self.socket())
    }

    fn client(&self) -> Client {
        Client::new(self.socket())
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.directory.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn incoming_files(&self) -> usize {
        std::fs::read_dir(self.directory.path().join("incoming")).unwrap().count()
    }

    async fn submit(&self, name: &str) -> JobView {
        let part = self.file("part.layerd", &[BEGINNING, b"some bytes"].concat());
        self.client().submit(&NewJob { part, name: name.into(), recipe: None }, |_, _| {}).await.unwrap()
    }
}

fn empty_snapshot() -> Snapshot {
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

async fn obey(mut desk: Desk, directory: PathBuf) {
    while let Some(Order { command, reply }) = desk.orders.next().await {
        let mut answer = Err(CommandError::new(404, "no such job"));
        desk.snapshot.send_modify(|snapshot| answer = carry_out(command, snapshot, &directory));
        if let Ok(Answer::Job(job)) = &answer {
            let _ = desk.events.send(Event::Job(job.clone()));
        }
        let _ = reply.send(answer);
    }
}

fn carry_out(command: Command, snapshot: &mut Snapshot, directory: &Path) -> Result<Answer, CommandError> {
    let (id, state) = match command {
        Command::Submit(new) => {
            let id = format!("job-{}", snapshot.jobs.len() + 1);
            let text = new.recipe_text.unwrap_or_default();
            std::fs::write(directory.join(format!("{id}.toml")), text).unwrap();
            new.part.persist(directory.join(format!("{id}.layerd"))).unwrap();
            snapshot.jobs.push(queued(&id, &new.name, new.recipe_name));
            return Ok(snapshot.jobs[snapshot.jobs.len() - 1].clone().into());
        }
        Command::Raise => return Ok(Answer::Raise(RaiseView { from_um: 3_200, to_um: 30_000, warning: None })),
        Command::Remove(id) => {
            let known = snapshot.jobs.len();
            snapshot.jobs.retain(|job| job.id != id);
            let removed = Answer::Removed(RemovedView { id, freed_bytes: 4096 });
            return if snapshot.jobs.len() < known { Ok(removed) } else { Err(CommandError::new(404, "no such job")) };
        }
        Command::Pause(id) => (id, JobState::Paused),
        Command::Resume { in_doubt: Some(InDoubt::Repeat), .. } => {
            return Err(CommandError::new(409, "nothing is in doubt"));
        }
        Command::Resume { id, .. } => (id, JobState::Printing),
        Command::Stop(id) => (id, JobState::Stopped),
        Command::Abort(Some(id)) => (id, JobState::Aborted),
        Command::Abort(None) => {
            let active = snapshot.active().ok_or_else(|| CommandError::new(409, "nothing is printing"))?;
            (active.id.clone(), JobState::Aborted)
        }
    };
    let job = snapshot.jobs.iter_mut().find(|job| job.id == id).ok_or_else(|| CommandError::new(404, "no such job"))?;
    job.state = state;
    Ok(job.clone().into())
}

fn queued(id: &str, name: &str, recipe: Option<String>) -> JobView {
    JobView {
        id: id.into(),
        name: name.into(),
        state: JobState::Queued,
        recipe: recipe.unwrap_or_else(|| "default".into()),
        layers_done: 0,
        layers_total: 0,
        layer: None,
        eta_s: None,
        late_layers: 0,
        late_ms_total: 0,
        submitted_ms: 1,
        started_ms: None,
        ended_ms: None,
        reason: None,
        in_doubt: None,
        warning: None,
    }
}

/// One raw HTTP exchange; the connection is closed by the daemon.
fn raw(socket: &Path, request: &[u8]) -> String {
    let mut stream = std::os::unix::net::UnixStream::connect(socket).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    // The daemon may answer and close before it has read everything.
    let _ = stream.write_all(request);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

async fn raw_async(socket: PathBuf, request: impl Into<Vec<u8>>) -> String {
    let request = request.into();
    tokio::task::spawn_blocking(move || raw(&socket, &request)).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_submitted_and_obeys_every_order() {
    let daemon = Daemon::start().await;
    let client = daemon.client();
    // Larger than any buffer on the way, not a multiple of the part size.
    let mut bytes: Vec<u8> = (0..3_000_017_u32).map(|index| (index % 251) as u8).collect();
    bytes[..BEGINNING.len()].copy_from_slice(BEGINNING);
    let part = daemon.file("part.layerd", &bytes);
    let recipe = "name = \"größer\"\n# 100 %\n".to_owned();
    let new = NewJob { part, name: "Würfel 1.layerd".into(), recipe: Some(("fein".into(), recipe.clone())) };
    let mut last = (0, 0);
    let job = client.submit(&new, |sent, total| last = (sent, total)).await.unwrap();
    assert_eq!(last, (3_000_017, 3_000_017));
    assert_eq!((job.name.as_str(), job.recipe.as_str(), job.state), ("Würfel 1.layerd", "fein", JobState::Queued));
    assert!(std::fs::read(daemon.directory.path().join("job-1.layerd")).unwrap() == bytes, "the file arrives whole");
    assert_eq!(std::fs::read_to_string(daemon.directory.path().join("job-1.toml")).unwrap(), recipe);
    assert_eq!(daemon.incoming_files(), 0);

    assert_eq!(client.status().await.unwrap().queue, vec![job.clone()]);
    assert_eq!(client.resume(&job.id, ResumeBody::default()).await.unwrap().state, JobState::Printing);
    let status = client.status().await.unwrap();
    assert_eq!((status.active.map(|job| job.id), status.queue.len()), (Some("job-1".into()), 0));
    assert_eq!(client.order(&job.id, "pause").await.unwrap().state, JobState::Paused);
    assert_eq!(client.order(&job.id, "stop").await.unwrap().state, JobState::Stopped);
    assert_eq!(client.order(&job.id, "abort").await.unwrap().state, JobState::Aborted);
    assert_eq!(client.job(&job.id).await.unwrap().state, JobState::Aborted);
    assert_eq!(client.jobs().await.unwrap().len(), 1);
    assert_eq!(client.raise().await.unwrap(), RaiseView { from_um: 3_200, to_um: 30_000, warning: None });
    assert_eq!(client.remove(&job.id).await.unwrap(), RemovedView { id: job.id.clone(), freed_bytes: 4096 });
    assert!(matches!(client.remove(&job.id).await.unwrap_err(), ClientError::Refused { status: 404, .. }));
    assert!(!client.get::<DeviceView>("/v1/device").await.unwrap().connected);
}

#[tokio::test(flavor = "multi_thread")]
async fn abort_needs_no_id_and_says_when_nothing_prints() {
    let daemon = Daemon::start().await;
    let client = daemon.client();
    let refused = client.abort_active().await.unwrap_err();
    assert!(matches!(&refused, ClientError::Refused { status: 409, .. }), "{refused}");
    let job = daemon.submit("one").await;
    client.resume(&job.id, ResumeBody::default()).await.unwrap();
    assert_eq!(client.abort_active().await.unwrap().state, JobState::Aborted);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_abort_overtakes_orders_that_wait() {
    let (handle, mut desk) = channel(empty_snapshot());
    let pause = tokio::spawn({
        let handle = handle.clone();
        async move { handle.order(Command::Pause("a".into()), Caller::default()).await }
    });
    tokio::time::sleep(Duration::from_millis(50)).await;
    let abort = tokio::spawn(async move { handle.order(Command::Abort(None), Caller::default()).await });
    tokio::time::sleep(Duration::from_millis(50)).await;
    let first = desk.orders.next().await.unwrap();
    assert!(matches!(first.command, Command::Abort(None)), "{:?}", first.command);
    assert!(matches!(desk.orders.next().await.unwrap().command, Command::Pause(_)));
    drop(desk);
    drop(first);
    assert_eq!(abort.await.unwrap().unwrap_err().status, 503);
    assert_eq!(pause.await.unwrap().unwrap_err().status, 503);
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_beyond_the_queue_are_refused_at_once() {
    let (handle, desk) = channel(empty_snapshot());
    let waiting: Vec<_> = (0..40)
        .map(|_| {
            let handle = handle.clone();
            tokio::spawn(async move { handle.order(Command::Pause("a".into()), Caller::default()).await })
        })
        .collect();
    tokio::time::sleep(Duration::from_millis(50)).await;
    drop(desk);
    let mut full = 0;
    for order in waiting {
        full += usize::from(order.await.unwrap().unwrap_err().message.contains("too many"));
    }
    assert_eq!(full, 24, "16 of 40 wait");
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_get_a_status_and_a_sentence() {
    let daemon = Daemon::start().await;
    daemon.submit("one").await;
    let close = "host: x\r\nconnection: close\r\n";
    let post = |path: &str, extra: &str, body: &str| {
        format!("POST {path} HTTP/1.1\r\n{close}{extra}content-length: {}\r\n\r\n{body}", body.len())
    };
    let long_recipe = format!("x-layerd-name: a\r\nx-layerd-recipe: {}\r\n", "x".repeat(16_385));
    let huge = "POST /v1/jobs HTTP/1.1\r\nhost: x\r\nconnection: close\r\nx-layerd-name: a\r\n";
    let cases = [
        (format!("GET /v2/status HTTP/1.1\r\n{close}\r\n"), "404", "/v2/status"),
        (format!("GET /v1/jobs/none HTTP/1.1\r\n{close}\r\n"), "404", "none"),
        (format!("DELETE /v1/status HTTP/1.1\r\n{close}\r\n"), "405", "DELETE"),
        (format!("DELETE /v1/jobs/none HTTP/1.1\r\n{close}\r\n"), "404", "no such job"),
        (format!("GET /v1/raise HTTP/1.1\r\n{close}\r\n"), "405", "GET"),
        (post("/v1/jobs/job-1/explode", "", ""), "404", "explode"),
        (post("/v1/jobs/job-9/pause", "", ""), "404", "no such job"),
        (post("/v1/jobs/job-1/resume", "", "{\"in_doubt\": \"perhaps\"}"), "400", "perhaps"),
        (post("/v1/jobs/job-1/resume", "", "{\"doubt\": 1}"), "400", "in_doubt"),
        (post("/v1/jobs/job-1/resume", "", &"x".repeat(5000)), "400", "body"),
        (post("/v1/jobs/job-1/resume", "", "{\"in_doubt\": \"repeat\"}"), "409", "nothing is in doubt"),
        (post("/v1/jobs", "", "bytes"), "400", "x-layerd-name"),
        (post("/v1/jobs", "x-layerd-name: %20\r\n", "bytes"), "400", "x-layerd-name"),
        (post("/v1/jobs", "x-layerd-name: %zz\r\n", "bytes"), "400", "percent"),
        (post("/v1/jobs", "x-layerd-name: a\r\n", ""), "400", "empty"),
        (post("/v1/jobs", &long_recipe, "bytes"), "400", "16384"),
        (format!("{huge}content-length: 9000000000000000\r\n\r\n"), "507", "needs 8381903.2 GiB"),
    ];
    for (request, status, words) in cases {
        let answer = raw_async(daemon.socket(), request.clone()).await;
        assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{request:.60}\n{answer}");
        assert!(answer.contains("{\"error\":") && answer.contains(words), "{request:.60}\n{answer}");
    }
    assert_eq!(daemon.incoming_files(), 0, "nothing half-written is left");
    let answer = raw_async(daemon.socket(), "no HTTP at all\r\n\r\n").await;
    assert!(answer.starts_with("HTTP/1.1 400 "), "{answer}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_breaks_off_leaves_nothing() {
    let daemon = Daemon::start().await;
    let request = b"POST /v1/jobs HTTP/1.1\r\nhost: x\r\nx-layerd-name: a\r\ncontent-length: 100000\r\n\r\n";
    let mut stream = std::os::unix::net::UnixStream::connect(daemon.socket()).unwrap();
    stream.write_all(&[request, BEGINNING, b"first bytes"].concat()).unwrap();
    wait_until(|| daemon.incoming_files() == 1).await;
    drop(stream);
    wait_until(|| daemon.incoming_files() == 0).await;
    assert!(daemon.client().jobs().await.unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_build_file_is_refused_at_its_first_bytes() {
    let daemon = Daemon::start().await;
    let head = "POST /v1/jobs HTTP/1.1\r\nhost: x\r\nx-layerd-name: photo\r\ncontent-length: 1000000\r\n\r\n";
    let cases: [(&[u8], &str); 3] = [
        (b"\x89PNG\r\n\x1a\n", "photo: it is not a build file"),
        (b"\x89PN", "photo: it is not a build file"),
        (b"\x89LYD\r\n\x1a\n\x07\0\0\0", "photo: it is a build file of version 7"),
    ];
    for (beginning, words) in cases {
        // A megabyte is announced, a few bytes are sent, and the answer is there.
        let answer = raw_async(daemon.socket(), [head.as_bytes(), beginning].concat()).await;
        assert!(answer.starts_with("HTTP/1.1 422 ") && answer.contains(words), "{answer}");
    }
    assert_eq!(daemon.incoming_files(), 0);
}

#[test]
fn the_job_that_ended_last_is_told() {
    let mut snapshot = empty_snapshot();
    assert_eq!(snapshot.status().last, None);
    for (id, state, ended_ms) in [
        ("1", JobState::Failed, None),
        ("2", JobState::Completed, Some(5)),
        ("3", JobState::Stopped, Some(9)),
        ("4", JobState::Aborted, Some(7)),
        ("5", JobState::Interrupted, Some(11)),
        ("6", JobState::Queued, None),
    ] {
        snapshot.jobs.push(JobView { state, ended_ms, ..queued(id, "part", None) });
    }
    assert_eq!(snapshot.status().last.map(|job| job.id), Some("3".into()));
}

async fn wait_until(condition: impl Fn() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < Duration::from_secs(10), "waited in vain");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_refused_upload_tells_why_however_large_it_is() {
    let daemon = Daemon::start().await;
    let part = daemon.file("part.layerd", &vec![1; 8_000_000]);
    let refused =
        daemon.client().submit(&NewJob { part, name: " ".into(), recipe: None }, |_, _| {}).await.unwrap_err();
    assert!(refused.to_string().contains("x-layerd-name"), "{refused}");
}

#[tokio::test(flavor = "multi_thread")]
async fn subscribers_hear_what_happens_and_when_they_lag() {
    let daemon = Daemon::start().await;
    let mut events = daemon.client().events().await.unwrap();
    assert!(matches!(events.next().await.unwrap(), Some(Event::Status(_))));
    let job = daemon.submit("one").await;
    assert_eq!(events.next().await.unwrap(), Some(Event::Job(Box::new(job))));
    // Far more than the queues and socket buffers between hold.
    let text = "x".repeat(1000);
    for _ in 0..5000 {
        let _ = daemon.events.send(Event::Notice { text: text.clone() });
    }
    let mut heard = 0;
    let missed = loop {
        match events.next().await.unwrap() {
            Some(Event::Notice { .. }) => heard += 1,
            Some(Event::Lagged { missed }) => break missed,
            other => panic!("unexpected {other:?}"),
        }
    };
    assert!(missed > 0 && heard + missed <= 5000, "{heard} heard, {missed} missed");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_end_of_the_daemon_ends_streams_and_takes_no_time() {
    let daemon = Daemon::start().await;
    let mut events = daemon.client().events().await.unwrap();
    events.next().await.unwrap();
    let _idle = tokio::net::UnixStream::connect(daemon.socket()).await.unwrap();
    daemon.shutdown.send(true).unwrap();
    for server in daemon.servers {
        tokio::time::timeout(Duration::from_secs(5), server).await.expect("ends soon").unwrap();
    }
    // A stream cut off by the end may be told as an end or as broken; both mean that no more comes.
    assert!(!matches!(events.next().await, Ok(Some(_))));
}

#[tokio::test(flavor = "multi_thread")]
async fn subscribers_are_limited_and_keep_no_abort_out() {
    let daemon = Daemon::start().await;
    let mut streams = Vec::new();
    for _ in 0..24 {
        streams.push(daemon.client().events().await.unwrap());
    }
    let refused = daemon.client().events().await.unwrap_err();
    assert!(matches!(refused, ClientError::Refused { status: 503, .. }), "{refused}");
    assert!(matches!(daemon.client().abort_active().await, Err(ClientError::Refused { status: 409, .. })));
    streams.clear();
    let began = Instant::now();
    while daemon.client().events().await.is_err() {
        assert!(began.elapsed() < Duration::from_secs(10), "places are given back");
    }
}

/// Connections that say nothing, or the beginning of a request.
fn half_open(socket: &Path, count: usize) -> Vec<std::os::unix::net::UnixStream> {
    let open = |index| {
        let mut stream = std::os::unix::net::UnixStream::connect(socket).unwrap();
        if index % 2 == 0 {
            let _ = stream.write_all(b"POST /v1/jobs HTTP/1.1\r\nhost: x\r\nx-layerd-name: ");
        }
        stream
    };
    (0..count).map(open).collect()
}

const STATUS: &str = "GET /v1/status HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n";
const ABORT: &str = "POST /v1/abort HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";

#[tokio::test(flavor = "multi_thread")]
async fn beyond_the_limit_503_comes_at_once_and_an_abort_gets_through() {
    let daemon = Daemon::start().await;
    let job = daemon.submit("one").await;
    daemon.client().resume(&job.id, ResumeBody::default()).await.unwrap();
    let [control, aborts] = [daemon.socket(), daemon.abort_socket()];
    let silent = tokio::task::spawn_blocking({
        let (control, aborts) = (control.clone(), aborts.clone());
        move || (half_open(&control, 300), half_open(&aborts, 300))
    });
    let _silent = silent.await.unwrap();
    // Nobody waits for the silent ones to be let go.
    let began = Instant::now();
    let answer = raw_async(control.clone(), STATUS).await;
    assert!(answer.starts_with("HTTP/1.1 503 ") && answer.contains("64 connections are open"), "{answer}");
    for socket in [&control, &aborts] {
        let answer = raw_async(socket.clone(), ABORT.replace("/v1/abort", "/v1/jobs/job-1/abort")).await;
        assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains("\"aborted\""), "{answer}");
        let answer = raw_async(socket.clone(), ABORT).await;
        assert!(answer.starts_with("HTTP/1.1 409 ") && answer.contains("nothing is printing"), "{answer}");
    }
    assert!(began.elapsed() < Duration::from_millis(900), "answered only when the silent ones were gone");
    // The silent ones hold their places for a second.
    wait_until_async(async || daemon.client().status().await.is_ok()).await;
}

async fn wait_until_async(condition: impl AsyncFn() -> bool) {
    let began = Instant::now();
    while !condition().await {
        assert!(began.elapsed() < Duration::from_secs(10), "waited in vain");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_does_not_arrive_within_a_second_is_given_up() {
    let daemon = Daemon::start().await;
    for socket in [daemon.socket(), daemon.abort_socket()] {
        let took = tokio::task::spawn_blocking(move || {
            let mut stream = std::os::unix::net::UnixStream::connect(socket).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(9))).unwrap();
            stream.write_all(b"POST /v1/abort HTTP/1.1\r\n").unwrap();
            let began = Instant::now();
            let _ = stream.read_to_end(&mut Vec::new());
            began.elapsed()
        });
        let took = took.await.unwrap();
        assert!((Duration::from_millis(900)..Duration::from_secs(8)).contains(&took), "{took:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_socket_for_aborts_takes_nothing_else() {
    let daemon = Daemon::start().await;
    let answer = raw_async(daemon.abort_socket(), STATUS).await;
    assert!(answer.starts_with("HTTP/1.1 404 ") && answer.contains("takes only POST /v1/abort"), "{answer}");
    let answer = raw_async(daemon.abort_socket(), ABORT).await;
    assert!(answer.starts_with("HTTP/1.1 409 ") && answer.contains("nothing is printing"), "{answer}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_abort_falls_back_to_the_common_socket() {
    let daemon = Daemon::start().await;
    let job = daemon.submit("one").await;
    std::fs::remove_file(daemon.abort_socket()).unwrap();
    assert_eq!(daemon.client().order(&job.id, "abort").await.unwrap().state, JobState::Aborted);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_queue_refuses_a_job_before_its_part_is_read() {
    let daemon = Daemon::start().await;
    for _ in 0..MAX_QUEUED_JOBS {
        daemon.submit("one").await;
    }
    // Only announced: whoever waits for the bytes waits for ever.
    let request =
        "POST /v1/jobs HTTP/1.1\r\nhost: x\r\nconnection: close\r\nx-layerd-name: a\r\ncontent-length: 99999\r\n\r\n";
    let answer = raw_async(daemon.socket(), request).await;
    assert!(answer.starts_with("HTTP/1.1 503 ") && answer.contains("the queue is full: 64 jobs wait"), "{answer}");
    assert_eq!(daemon.incoming_files(), 0);
    daemon.client().order("job-7", "stop").await.unwrap();
    daemon.submit("another").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sockets_are_for_owner_and_group_and_stale_ones_are_replaced() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("control.sock");
    let first = socket::bind(&path).await.unwrap();
    for path in [path.clone(), socket::abort_path(&path)] {
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o660);
    }
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 2, "nothing else is left there");
    let refused = socket::bind(&path).await.unwrap_err();
    assert!(matches!(&refused, BindError::AlreadyRunning(_)), "{refused}");
    drop(first);
    assert!(path.exists(), "as after a crash");
    drop(socket::bind(&path).await.unwrap());

    std::fs::remove_file(&path).unwrap();
    std::fs::write(&path, "a file").unwrap();
    assert!(matches!(socket::bind(&path).await.unwrap_err(), BindError::NotASocket(_)));
}

#[tokio::test]
async fn the_longest_path_of_a_socket_works_and_a_longer_one_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let with_length = |length: usize| {
        let room = length - directory.path().as_os_str().len() - 1;
        directory.path().join("s".repeat(room))
    };
    drop(socket::bind(&with_length(101)).await.unwrap());
    let long = socket::bind(&with_length(102)).await.unwrap_err().to_string();
    assert!(long.contains("102 bytes") && long.contains("at most 101"), "{long}");
    let missing = socket::bind(&directory.path().join("none/control.sock")).await.unwrap_err().to_string();
    assert!(missing.contains("/none does not exist"), "{missing}");
}

#[tokio::test]
async fn without_a_daemon_the_remedy_is_told() {
    let directory = tempfile::tempdir().unwrap();
    let error = Client::new(directory.path().join("control.sock")).status().await.unwrap_err();
    let text = error.to_string();
    assert!(text.contains("layerd --config FILE") && text.contains("LAYERD_SOCKET"), "{text}");
}
