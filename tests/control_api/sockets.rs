//! The sockets: paths, rights, crowds, and the one for aborts.

use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use layerd::api::ResumeBody;
use layerd::cli::client::Client;
use layerd::daemon::http::socket::{self, BindError};
use layerd::job::JobState;

use super::bench::*;

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
