//! New jobs, and requests that are refused: bad ones, interrupted ones, what is no build file, a full queue.

use std::io::Write;

use layerd::cli::client::NewJob;
use layerd::daemon::handle::MAX_QUEUED_JOBS;

use super::bench::*;

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

#[tokio::test(flavor = "multi_thread")]
async fn a_refused_upload_tells_why_however_large_it_is() {
    let daemon = Daemon::start().await;
    let part = daemon.file("part.layerd", &vec![1; 8_000_000]);
    let refused =
        daemon.client().submit(&NewJob { part, name: " ".into(), recipe: None }, |_, _| {}).await.unwrap_err();
    assert!(refused.to_string().contains("x-layerd-name"), "{refused}");
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
