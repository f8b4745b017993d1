//! Orders: a job from its submission to its removal, aborts before everything else, limits.

use std::time::Duration;

use layerd::api::{DeviceView, JobView, RaiseView, RemovedView, ResumeBody};
use layerd::cli::client::{ClientError, NewJob};
use layerd::daemon::caller::Caller;
use layerd::daemon::handle::{MAX_QUEUED_JOBS, Order, channel};
use layerd::job::JobState;

use super::bench::*;

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
async fn a_path_that_is_no_text_is_refused_with_json() {
    let daemon = Daemon::start().await;
    for (socket, request) in [
        (daemon.socket(), "GET /v1/jobs/%ff"),
        (daemon.socket(), "GET /v1/jobs/%ff/log"),
        (daemon.socket(), "POST /v1/jobs/1/%ff"),
        (daemon.abort_socket(), "POST /v1/jobs/%ff/abort"),
    ] {
        let head = format!("{request} HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 0\r\n\r\n");
        let answer = raw_async(socket, head).await;
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        assert!(head.starts_with("HTTP/1.1 400 ") && head.contains("application/json"), "{answer}");
        let error = serde_json::from_str::<serde_json::Value>(body).unwrap()["error"].as_str().unwrap().to_owned();
        assert!(error.contains("the path /v1/jobs/") && error.contains("%ff") && error.contains("UTF-8"), "{error}");
    }
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
        async move { handle.order(Order::Pause("a".into()), Caller::default()).await }
    });
    tokio::time::sleep(Duration::from_millis(50)).await;
    let abort = tokio::spawn(async move { handle.order(Order::Abort(None), Caller::default()).await });
    tokio::time::sleep(Duration::from_millis(50)).await;
    let first = desk.orders.next().await.unwrap();
    assert!(matches!(first.order, Order::Abort(None)), "{:?}", first.order);
    assert!(matches!(desk.orders.next().await.unwrap().order, Order::Pause(_)));
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
            tokio::spawn(async move { handle.order(Order::Pause("a".into()), Caller::default()).await })
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

#[tokio::test(flavor = "multi_thread")]
async fn a_part_again_takes_a_recipe_and_a_place_in_the_queue() {
    let daemon = Daemon::start().await;
    let client = daemon.client();
    daemon.submit("one").await;
    let again = client.again("job-1", None).await.unwrap();
    assert_eq!((again.id.as_str(), again.name.as_str(), again.state), ("job-2", "one", JobState::Queued));
    let recipe = ("fein".to_owned(), "name = \"größer\"\n# 100 %\n".to_owned());
    let other = client.again("job-1", Some(&recipe)).await.unwrap();
    assert_eq!(other.recipe, "fein");
    assert_eq!(std::fs::read_to_string(daemon.directory.path().join("job-3.toml")).unwrap(), recipe.1);
    let refused = client.again("job-9", None).await.unwrap_err();
    assert!(matches!(&refused, ClientError::Refused { status: 404, .. }), "{refused}");
    let answer =
        raw_async(daemon.socket(), "POST /v1/jobs/job-1/again HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").await;
    assert!(answer.starts_with("HTTP/1.1 201 "), "{answer}");
    let with_part =
        "POST /v1/jobs/job-1/again HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 3\r\n\r\nabc";
    let answer = raw_async(daemon.socket(), with_part).await;
    assert!(answer.starts_with("HTTP/1.1 400 ") && answer.contains("send no body"), "{answer}");
    for _ in 4..MAX_QUEUED_JOBS {
        daemon.submit("one").await;
    }
    let refused = client.again("job-1", None).await.unwrap_err();
    assert!(refused.to_string().contains("the queue is full: 64 jobs wait"), "{refused}");
}
