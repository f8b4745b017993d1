//! Subscribers to events: what they hear, how they end, how many there may be.

use std::time::{Duration, Instant};

use layerd::api::Event;
use layerd::cli::client::ClientError;

use super::bench::*;

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
