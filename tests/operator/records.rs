//! What is recorded of jobs: beginning, duration, end and resin in `jobs` and `status`, and the log of a job.

use std::fs;

use serde_json::Value;

use super::support::{Bench, Setup, wait_until};
use super::{PART, slowly};

/// Waits until the resin of a job is estimated; its view.
fn with_resin(bench: &Bench, id: u64) -> Value {
    wait_until("an estimate of the resin", || bench.job(id)["resin_ml"].is_f64());
    bench.job(id)
}

/// How often the log says that the note of job 1 is not used.
fn warnings_of_resin(bench: &Bench) -> usize {
    let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
    log.matches("the note of its resin, spool/jobs/00000001/resin, is not used: ").count()
}

/// The lines of a job's log without their times.
fn story(bench: &Bench, arguments: &[&str]) -> Vec<String> {
    let told = bench.ok(&[&["log"], arguments].concat());
    told.lines().map(|line| line.split_once(" UTC  ").unwrap_or_else(|| panic!("no time: {line}")).1.into()).collect()
}

#[test]
fn a_job_that_is_over_tells_when_it_began_how_long_it_took_and_how_much_resin_it_took() {
    let mut bench = Bench::start(Setup::default());
    bench.ok(&PART);
    let id = bench.start_job("part.layerd");
    bench.wait_for(id, &["completed"]);
    let job = with_resin(&bench, id);
    let [began, ended] = ["started_ms", "ended_ms"].map(|key| job[key].as_u64().expect("a time"));
    assert_eq!(job["duration_s"], (ended - began) / 1000, "{job}");
    let told: f64 = bench.json(&["info", "part.layerd"])["resin_ml"].as_f64().expect("a volume");
    let [all, done] = ["resin_ml", "resin_done_ml"].map(|key| job[key].as_f64().expect("a volume"));
    assert!((all / told - 1.0).abs() < 0.05, "{all} ml, where `info` says {told} ml");
    assert_eq!(all, done, "all of it is printed");
    let jobs = bench.ok(&["jobs"]);
    let lines: Vec<&str> = jobs.lines().collect();
    assert!(lines[0].starts_with("ID ") && lines[0].contains("BEGAN (UTC)") && lines[0].ends_with("ENDED"), "{jobs}");
    assert!(lines[1].starts_with("1 ") && lines[1].contains("completed") && lines[1].contains("24/24"), "{jobs}");
    assert_eq!(lines[1].matches(':').count(), 2, "it began and ended at a time of day: {jobs}");
    assert!(lines[2].contains("part.layerd, recipe bench, about 0.0") && lines[2].ends_with(" ml of resin"), "{jobs}");
    assert!(bench.ok(&["status"]).contains(" ml of resin"), "{}", bench.ok(&["status"]));
    // All of this is in the spool.
    bench.terminate_daemon();
    bench.start_daemon();
    let again = bench.job(id);
    for key in ["resin_ml", "resin_done_ml"] {
        assert_eq!(again[key], job[key], "{key} of {again}");
    }
    let again_ms = again["started_ms"].as_u64().expect("a time");
    assert!(again_ms.abs_diff(began) < 1000, "it is the time of a record, written at about the same time: {again}");
    assert!(again["duration_s"].is_u64(), "{again}");
}

#[test]
fn a_queued_job_tells_its_resin_and_a_running_one_how_much_of_it_is_printed() {
    let mut bench = Bench::prepare(Setup { confirm_plate: true, ..slowly() });
    bench.start_daemon();
    bench.ok(&PART);
    let id = bench.start_job("part.layerd");
    with_resin(&bench, id);
    // After a restart it waits for the operator.
    bench.kill_daemon();
    bench.start_daemon();
    let queued = with_resin(&bench, id);
    assert_eq!(
        (&queued["state"], &queued["resin_done_ml"]),
        (&"queued".into(), &0.0.into()),
        "before any device is there"
    );
    assert!(queued["duration_s"].is_null() && queued["started_ms"].is_null(), "{queued}");
    let jobs = bench.ok(&["jobs"]);
    assert!(jobs.contains(" ml of resin, submitted ") && jobs.contains(" ago"), "{jobs}");
    assert!(bench.ok(&["status"]).contains("queued   1 part.layerd, about 0.0"), "{}", bench.ok(&["status"]));
    // A lost or damaged note is no loss: the part is sampled again.
    let note = bench.path("spool/jobs/00000001/resin");
    let whole = fs::read(&note).expect("the note");
    for damaged in [None, Some(&whole[..whole.len() / 2]), Some(b"{\"below_ml\":[1.0]}"), Some(b"")] {
        bench.kill_daemon();
        fs::remove_file(&note).expect("the note");
        damaged.inspect(|bytes| fs::write(&note, bytes).expect("damaged"));
        let warnings = warnings_of_resin(&bench);
        bench.start_daemon();
        assert_eq!(with_resin(&bench, id)["resin_ml"], queued["resin_ml"]);
        wait_until("a note of the estimate", || fs::read(&note).is_ok_and(|bytes| bytes == whole));
        assert_eq!(warnings_of_resin(&bench) - warnings, usize::from(damaged.is_some()));
    }
    bench.start_device();
    wait_until("the device", || bench.json(&["status"])["link"]["state"] == "connected");
    bench.ok(&["resume", "1"]);
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(2));
    let job = bench.job(id);
    let [all, done] = ["resin_ml", "resin_done_ml"].map(|key| job[key].as_f64().expect("a volume"));
    assert!(done > 0.0 && done < all, "{job}");
    let status = bench.ok(&["status"]);
    assert!(status.contains("resin    about 0.0") && status.contains(" of 0.0"), "{status}");
    assert!(!status.contains(" of resin"), "the label says it: {status}");
    let output = bench.layerctl_command(&["status"]).env("TZ", "HERE-02:30").output().expect("runs");
    let status = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(status.contains("until about 20") && status.contains(" +02:30"), "the reader's own time: {status}");
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
}

#[test]
fn a_job_that_never_began_took_no_time() {
    let mut bench = Bench::prepare(slowly());
    bench.start_daemon();
    bench.ok(&PART);
    let id = bench.start_job("part.layerd");
    bench.wait_for(id, &["checking"]);
    bench.ok(&["abort"]);
    let job = bench.wait_for(id, &["aborted"]);
    assert!(job["started_ms"].is_null() && job["duration_s"].is_null(), "{job}");
    let jobs = bench.ok(&["jobs"]);
    let row = jobs.lines().nth(1).expect("a row");
    assert!(row.starts_with("1       aborted              0/24  -              -            "), "{jobs}");
    assert!(jobs.contains("before it began") && !jobs.contains("submitted"), "{jobs}");
}

#[test]
fn the_log_of_a_job_tells_layers_pauses_orders_and_the_end() {
    let bench = Bench::start(Setup { exposure_ms: 3000, time_scale: 10, ..Setup::default() });
    bench.ok(&PART);
    let id = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(2));
    bench.ok(&["pause"]);
    bench.wait_for(id, &["paused"]);
    let done = bench.job(id)["layers_done"].as_u64().expect("layers_done");
    let told = story(&bench, &["1"]);
    let layers = format!("layers 0 to {}: exposed, the last at ", done - 1);
    assert_eq!(told[0], "accepted: part.layerd, 24 layers");
    assert!(told[1..3].contains(&"took the machine, layer 0 is next".into()), "{told:?}");
    assert!(told[1..3].contains(&"the plate is taken to be empty".into()), "{told:?}");
    assert!(told[3].starts_with(&layers), "`{layers}` is not in {told:?}");
    assert_eq!(told[4..], ["paused"]);
    bench.ok(&["resume"]);
    wait_until("a layer more", || bench.job(id)["layers_done"].as_u64() > Some(done));
    bench.ok(&["stop"]);
    bench.wait_for(id, &["stopped"]);
    let told = story(&bench, &["1"]);
    assert_eq!(told[5], "resumed");
    for words in ["ordered to stop", "parked: the machine rests, and the part is where it is safe"] {
        assert!(told.iter().any(|line| line == words), "`{words}` is not in {told:?}");
    }
    assert!(told.last().expect("an end").starts_with("ended: stopped: stopped by the operator"), "{told:?}");
    let all = story(&bench, &["1", "--all"]);
    for words in ["layer 1: exposure commanded", "layer 1: exposed, the device confirms"] {
        assert!(all.iter().any(|line| line == words), "`{words}` is not in {all:?}");
    }
    let records = bench.ok(&["log", "1", "--json"]);
    let records: Vec<Value> = records.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(records[0]["record"], "accepted");
    assert_eq!((&records[0]["name"], &records[0]["layers_total"]), (&"part.layerd".into(), &24.into()));
    assert!(records.iter().any(|entry| entry["record"] == "ordered" && entry["order"] == "stop"));
    let confirmed = records.iter().filter(|entry| entry["record"] == "confirmed").count() as u64;
    assert_eq!(confirmed, bench.job(id)["layers_done"].as_u64().expect("layers_done"));
    let times: Vec<u64> = records.iter().map(|entry| entry["at_ms"].as_u64().expect("a time")).collect();
    assert!(times.is_sorted() && times[0] > 0, "{times:?}");
    let output = bench.layerctl(&["log", "77"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("there is no job `77`; `layerctl jobs` lists them"));
}

#[test]
fn the_log_tells_of_a_crash_and_of_a_damaged_journal() {
    let mut bench = Bench::start(slowly());
    bench.ok(&PART);
    bench.start_and_kill();
    bench.start_daemon();
    bench.wait_for(1, &["interrupted"]);
    let told = story(&bench, &["1"]);
    let last = told.last().expect("a line");
    assert!(last.starts_with("layer"), "its end is not recorded: {told:?}");
    wait_until("the device", || bench.json(&["status"])["link"]["state"] == "connected");
    bench.ok(&["resume", "1"]);
    bench.wait_for(1, &["printing"]);
    bench.ok(&["abort", "1"]);
    bench.wait_for(1, &["aborted"]);
    let told = story(&bench, &["1"]);
    assert!(
        told.iter().any(|line| line.ends_with("the daemon ended without recording why (crash or power cut)")),
        "{told:?}"
    );
    assert_eq!(told.iter().filter(|line| *line == "ordered to abort").count(), 1, "{told:?}");
    assert!(told.last().expect("an end").starts_with("ended: aborted"), "{told:?}");
    // A bit in the middle: what stands before it is readable.
    let journal = bench.path("spool/jobs/00000001/journal");
    let mut bytes = fs::read(&journal).expect("a journal");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    fs::write(&journal, bytes).expect("damaged");
    for arguments in [&["log", "1"][..], &["log", "1", "--json"]] {
        let output = bench.layerctl(arguments);
        let (out, told) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert_eq!(output.status.code(), Some(1), "{out}{told}");
        assert!(out.contains("part.layerd") && out.lines().count() >= 2, "{out}");
        assert!(told.contains("journal is damaged: record ") && told.starts_with("error: the journal "), "{told}");
    }
    fs::remove_file(&journal).expect("removed");
    let output = bench.layerctl(&["log", "1"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(1) && told.contains("cannot open the journal"), "{told}");
}

#[test]
fn a_damaged_last_record_is_told_and_the_others_count() {
    let mut bench = Bench::start(Setup::default());
    bench.ok(&PART);
    let id = bench.start_job("part.layerd");
    bench.wait_for(id, &["completed"]);
    let exposed = bench.exposed_layers();
    bench.terminate_daemon();
    let journal = bench.path("spool/jobs/00000001/journal");
    let mut bytes = fs::read(&journal).expect("a journal");
    *bytes.last_mut().expect("a record") ^= 0x10;
    fs::write(&journal, &bytes).expect("damaged");
    bench.start_daemon();
    let job = bench.wait_for(id, &["interrupted"]);
    let output = bench.layerctl(&["log", "1"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{told}");
    let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
    for text in [told.as_str(), log.as_str(), job["reason"].as_str().expect("a reason")] {
        assert!(text.contains("the last record of the journal "), "{text}");
        assert!(text.contains("00000001/journal is damaged and was dropped: record "), "{text}");
    }
    wait_until("the device", || bench.json(&["status"])["link"]["state"] == "connected");
    bench.ok(&["resume", "1"]);
    bench.wait_for(id, &["completed"]);
    assert_eq!(bench.exposed_layers(), exposed, "no layer is exposed again");
    let told = story(&bench, &["1"]);
    let dropped = told.iter().filter(|line| line.contains("00000001/journal is damaged and was dropped: record "));
    assert_eq!(dropped.count(), 1, "it is kept: {told:?}");
}
