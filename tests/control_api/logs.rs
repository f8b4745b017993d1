//! The log of a job: its journal, read and sent piece by piece.

use layerd::api::{LogEntry, LogRecord};
use layerd::cli::client::ClientError;
use layerd::job::{Journal, Record};

use super::bench::*;

/// A daemon that knows job 7 with a journal of so many layers, none of which it judges.
async fn with_journal(layers: usize) -> Daemon {
    let mut snapshot = empty_snapshot();
    snapshot.jobs.push(queued("7", "part", None));
    let daemon = Daemon::start_from(snapshot).await;
    let path = daemon.directory.path().join("jobs/00000007/journal");
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let accepted = Record::Accepted { key: 1, layer_count: 9, name: "Würfel\n1".into() };
    let mut journal = Journal::create(&path, accepted, 1).unwrap();
    let first = std::fs::metadata(&path).unwrap().len() as usize;
    journal.append(Record::Commanded { exposure: 0, boot_id: 5 }, 2).unwrap();
    journal.append(Record::Confirmed { exposure: 0 }, 3).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    bytes.extend(bytes[first..].repeat(layers - 1));
    std::fs::write(&path, bytes).unwrap();
    daemon
}

#[tokio::test(flavor = "multi_thread")]
async fn a_log_of_a_hundred_thousand_layers_comes_whole_and_in_order() {
    let daemon = with_journal(100_000).await;
    let mut log = daemon.client().log("7").await.unwrap();
    let first = log.next().await.unwrap().unwrap();
    let accepted = LogRecord::Accepted { name: "Würfel\n1".into(), layers_total: 9 };
    assert_eq!(first, LogEntry { at_ms: 1, material: None, record: accepted });
    let mut count = 0;
    while let Some(entry) = log.next().await.unwrap() {
        let expected =
            if count % 2 == 0 { LogRecord::Commanded { layer: 0 } } else { LogRecord::Confirmed { layer: 0 } };
        assert_eq!(entry, LogEntry { at_ms: 2 + count % 2, material: None, record: expected });
        count += 1;
    }
    assert_eq!((count, log.problem()), (200_000, None));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_log_is_json_line_by_line_and_says_last_what_cannot_be_read() {
    let daemon = with_journal(1).await;
    let get = "GET /v1/jobs/7/log HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n";
    let answer = raw_async(daemon.socket(), get).await;
    assert!(answer.starts_with("HTTP/1.1 200 ") && answer.contains("content-type: application/x-ndjson"), "{answer}");
    assert!(answer.contains("{\"at_ms\":2,\"record\":\"commanded\",\"layer\":0}\n"), "{answer}");
    let path = daemon.directory.path().join("jobs/00000007/journal");
    let mut bytes = std::fs::read(&path).unwrap();
    let length = bytes.len();
    // In the middle of the last record but one.
    bytes[length - 40] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let mut log = daemon.client().log("7").await.unwrap();
    let mut entries = Vec::new();
    while let Some(entry) = log.next().await.unwrap() {
        entries.push(entry);
    }
    let problem = log.problem().unwrap();
    assert!(entries.len() == 1 && problem.contains("record 1 at byte "), "{entries:?}, {problem}");
    std::fs::remove_file(path).unwrap();
    let refused = daemon.client().log("7").await.unwrap_err();
    assert!(matches!(&refused, ClientError::Refused { status: 500, .. }), "{refused}");
    let refused = daemon.client().log("8").await.unwrap_err();
    assert!(matches!(&refused, ClientError::Refused { status: 404, .. }), "{refused}");
}

#[tokio::test(flavor = "multi_thread")]
async fn readers_of_logs_are_limited_and_give_their_places_back() {
    let daemon = with_journal(100_000).await;
    let mut logs = Vec::new();
    for _ in 0..8 {
        let mut log = daemon.client().log("7").await.unwrap();
        log.next().await.unwrap();
        logs.push(log);
    }
    let refused = daemon.client().log("7").await.unwrap_err();
    assert!(matches!(&refused, ClientError::Refused { status: 503, .. }), "{refused}");
    assert_eq!(daemon.client().jobs().await.unwrap().len(), 1, "other requests are answered");
    logs.clear();
    wait_until_async(async || daemon.client().log("7").await.is_ok()).await;
}
