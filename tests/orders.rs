//! Orders and ends that must outlive the daemon, and layers in doubt that are told before a job goes on.

mod support;

use std::fs;

use serde_json::Value;
use support::{Bench, Setup, SmallDisk, signal, skipped, wait_until};

const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];

/// `clear_height_um` of the bench's machine.
const CLEAR_UM: i64 = 30_000;

/// A print whose first layer has light for some seconds.
fn under_light() -> (Bench, u64) {
    let bench = Bench::start(Setup { exposure_ms: 24_000, time_scale: 4, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("light", || has(&bench.acts(), "light_on"));
    (bench, id)
}

fn has(acts: &[Value], event: &str) -> bool {
    acts.iter().any(|act| act["event"] == event)
}

/// Where the plate came to rest last.
fn plate_um(acts: &[Value]) -> Option<i64> {
    acts.iter().rev().find(|act| act["event"] == "moved").and_then(|act| act["position_um"].as_i64())
}

fn reason(job: &Value) -> &str {
    job["reason"].as_str().unwrap_or_default()
}

/// A bench whose spool is a small disk of its own; `None`, and a message, where that cannot be mounted.
fn on_a_small_disk() -> Option<(Bench, SmallDisk)> {
    let mut bench = Bench::prepare(Setup { exposure_ms: 2000, time_scale: 20, ..Setup::default() });
    fs::create_dir(bench.path("spool")).expect("spool");
    let Some(disk) = SmallDisk::mount(&bench.path("spool")) else {
        skipped("mounting a small disk takes root");
        return None;
    };
    bench.start_device();
    bench.start_daemon();
    bench.ok(&SMALL);
    Some((bench, disk))
}

/// Starts a job and waits until some of its layers are done; its id.
fn some_layers(bench: &Bench) -> u64 {
    let id = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(2));
    id
}

/// The text with which `layerctl` refuses.
fn refusal(bench: &Bench, arguments: &[&str]) -> String {
    let output = bench.layerctl(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {output:?}");
    String::from_utf8(output.stderr).expect("UTF-8")
}

#[test]
fn an_order_that_was_answered_is_carried_out_after_a_kill() {
    for (order, state) in [("stop", "stopped"), ("abort", "aborted")] {
        let (mut bench, id) = under_light();
        bench.ok(&[order]);
        bench.kill_daemon();
        bench.start_daemon();
        let job = bench.wait_for(id, &[state, "interrupted", "failed", "completed"]);
        assert_eq!(job["state"], state, "{job}");
        let acts = bench.acts();
        assert!(has(&acts, "light_off") && plate_um(&acts) == Some(CLEAR_UM), "{order}: {acts:?}");
        assert_eq!(has(&acts, "exposed"), order == "stop", "{acts:?}");
        assert_eq!(acts.iter().filter(|act| act["event"] == "light_on").count(), 1, "it printed on: {acts:?}");
        // Its plate was lifted, and that is known: nobody is asked before the next part.
        bench.kill_daemon();
        bench.start_daemon();
        let next = bench.start_job("part.layerd");
        wait_until("the next job's light", || bench.acts().iter().filter(|act| act["event"] == "light_on").count() > 1);
        bench.ok(&["abort", &next.to_string()]);
    }
}

#[test]
fn an_order_waits_for_its_device_after_a_restart_and_keeps_the_job_from_going_on() {
    let (mut bench, id) = under_light();
    bench.ok(&["stop"]);
    signal(bench.device_pid(), "STOP");
    bench.kill_daemon();
    bench.start_daemon();
    let job = bench.job(id);
    assert!(job["state"] == "stopping" && reason(&job).contains("as soon as the device answers"), "{job}");
    let text = refusal(&bench, &["resume", &id.to_string()]);
    assert!(text.contains("ordered to stop") && text.contains("start the part again"), "{text}");
    signal(bench.device_pid(), "CONT");
    let job = bench.wait_for(id, &["stopped", "interrupted", "failed", "completed"]);
    assert_eq!(job["state"], "stopped", "{job}");
    assert_eq!(plate_um(&bench.acts()), Some(CLEAR_UM));
}

#[test]
fn an_order_for_an_interrupted_job_outlives_a_second_kill() {
    let (mut bench, id) = under_light();
    bench.kill_daemon();
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "interrupted");
    bench.ok(&["stop"]);
    bench.kill_daemon();
    bench.start_daemon();
    let job = bench.wait_for(id, &["stopped", "interrupted", "failed", "completed"]);
    assert_eq!((&job["state"], &job["layers_done"]), (&"stopped".into(), &1.into()), "{job}");
    assert_eq!(plate_um(&bench.acts()), Some(CLEAR_UM));
}

#[test]
fn a_layer_that_the_device_cannot_settle_is_told_before_resume() {
    let (mut bench, id) = under_light();
    bench.kill_daemon();
    bench.kill_device();
    bench.start_device();
    bench.start_daemon();
    wait_until("the doubt", || bench.job(id)["in_doubt"] == 0);
    let job = bench.job(id);
    assert!(job["state"] == "interrupted" && reason(&job).contains("in doubt"), "{job}");
    assert!(bench.ok(&["jobs"]).contains("--in-doubt"), "{}", bench.ok(&["jobs"]));
    // This device was reset, too: it does not know where its plate is, and the part hangs there.
    for arguments in [&["resume", "1"][..], &["resume", "1", "--in-doubt", "repeat"]] {
        let text = refusal(&bench, arguments);
        assert!(text.contains("does not know where its plate is") && text.contains("layerctl abort 1"), "{text}");
    }
    assert_eq!(bench.job(id)["state"], "interrupted", "nothing was begun for that");
    assert!(!has(&bench.acts(), "light_on"), "{:?}", bench.acts());
}

#[test]
fn a_layer_that_a_shutdown_cut_short_is_decided_by_the_operator() {
    // A shutdown waits for 30 s of light, not for 100.
    let mut bench = Bench::start(Setup { exposure_ms: 100_000, time_scale: 1, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("light", || has(&bench.acts(), "light_on"));
    assert_eq!(bench.terminate_daemon(), Some(0));
    assert_eq!(plate_um(&bench.acts()), Some(CLEAR_UM));
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    assert_eq!(bench.job(id)["in_doubt"], 0, "{}", bench.job(id));
    let text = refusal(&bench, &["resume", "1"]);
    assert!(text.contains("--in-doubt exposed") && text.contains("--in-doubt repeat"), "{text}");
    bench.ok(&["resume", "1", "--in-doubt", "repeat"]);
    wait_until("light again", || bench.acts().iter().filter(|act| act["event"] == "light_on").count() == 2);
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
}

#[test]
fn an_order_that_changes_nothing_names_its_job() {
    let (bench, id) = under_light();
    bench.ok(&["pause"]);
    bench.ok(&["pause"]);
    let text = refusal(&bench, &["resume", "1", "--in-doubt", "exposed"]);
    assert!(text.contains("no layer of job 1 is in doubt"), "{text}");
    let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
    assert!(log.contains("job 1: nothing to do: the job is pausing"), "{log}");
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
}

#[test]
fn a_pause_right_after_the_start_takes_effect_before_the_first_layer() {
    // Large layers, sixteen of which are checked while the job is opened: the order comes long before that ends.
    let (size_px, pixel_um, memory_budget) = ([8000, 6000], 2.5, "256MiB");
    let mut bench = Bench::prepare(Setup { size_px, pixel_um, memory_budget, ..Setup::default() });
    let recipe = fs::read_to_string(bench.path("recipe.toml")).expect("recipe");
    fs::write(bench.path("recipe.toml"), recipe.replace("bottom_layers = 0", "bottom_layers = 16")).expect("recipe");
    bench.start_device();
    bench.start_daemon();
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    let told = bench.ok(&["pause", &id.to_string()]);
    assert!(told.contains("is being checked; then it pauses before its first layer"), "{told}");
    let job = bench.wait_for(id, &["paused", "completed", "failed"]);
    assert_eq!((&job["state"], &job["layers_done"]), (&"paused".into(), &0.into()), "{job}");
    assert!(!has(&bench.acts(), "light_on"), "{:?}", bench.acts());
    bench.ok(&["resume", &id.to_string()]);
    wait_until("light", || has(&bench.acts(), "light_on"));
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
}

#[test]
fn a_layer_that_the_device_settles_is_in_no_doubt() {
    let (mut bench, id) = under_light();
    bench.kill_daemon();
    bench.start_daemon();
    // While it has light nobody can tell, and then the device can.
    wait_until("the end of the light", || bench.json(&["device"])["state"]["light_on"] == false);
    assert_eq!(bench.job(id)["in_doubt"], Value::Null, "{}", bench.job(id));
    let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
    assert!(log.contains("job 1 is interrupted: the daemon ended without warning"), "{log}");
    let text = refusal(&bench, &["resume", "1", "--in-doubt", "repeat"]);
    assert!(text.contains("no layer of job 1 is in doubt"), "{text}");
    bench.ok(&["resume"]);
    wait_until("the next layer", || bench.acts().iter().filter(|act| act["event"] == "light_on").count() == 2);
    assert_eq!(bench.exposed_layers(), [0]);
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
}

#[test]
fn an_end_on_a_full_disk_is_final() {
    for order in [None, Some("stop"), Some("abort")] {
        let Some((mut bench, disk)) = on_a_small_disk() else { return };
        let id = some_layers(&bench);
        disk.fill();
        let state = match order {
            None => "completed",
            Some("stop") => "stopped",
            Some(_) => "aborted",
        };
        if let Some(order) = order {
            let job = bench.json(&[order]);
            assert_eq!(job.get("warning"), None, "its room was kept: {job}");
        }
        bench.wait_for(id, &[state]);
        disk.fill();
        bench.kill_daemon();
        bench.start_daemon();
        assert_eq!(bench.job(id)["state"], state, "{}", bench.job(id));
        let text = refusal(&bench, &["resume", &id.to_string()]);
        assert!(text.contains(state), "{text}");
    }
}

/// Its plate stands in the resin: a disk without a free byte must not keep anybody from lifting it.
#[test]
fn a_daemon_starts_on_a_full_disk_and_ends_the_job_it_finds() {
    let Some((mut bench, disk)) = on_a_small_disk() else { return };
    let id = some_layers(&bench);
    bench.kill_daemon();
    disk.fill();
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "interrupted");
    let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
    assert!(log.contains(" are free in ") && log.contains("layerctl remove"), "{log}");
    let job = bench.json(&["abort"]);
    assert_eq!(job.get("warning"), None, "its room was kept: {job}");
    bench.wait_for(id, &["aborted"]);
    assert_eq!(plate_um(&bench.acts()), Some(CLEAR_UM));
    disk.fill();
    bench.kill_daemon();
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "aborted");
}

#[test]
fn an_order_that_cannot_be_written_is_carried_out_and_says_so() {
    let (bench, id) = under_light();
    let spool = bench.path("spool");
    fs::rename(&spool, bench.path("away")).expect("renamed");
    let output = bench.ok(&["abort"]);
    assert!(output.contains("warning") && output.contains("could not be written"), "{output}");
    let job = bench.wait_for(id, &["aborted", "interrupted", "failed"]);
    assert_eq!(job["state"], "aborted", "{job}");
    assert_eq!(plate_um(&bench.acts()), Some(CLEAR_UM));
}

#[test]
fn a_spool_that_vanishes_under_a_job_interrupts_it_with_the_plate_clear() {
    for (order, state) in [("stop", "stopped"), ("abort", "aborted")] {
        let bench = Bench::start(Setup { exposure_ms: 2000, time_scale: 20, ..Setup::default() });
        bench.ok(&SMALL);
        let id = some_layers(&bench);
        let done = bench.exposed_layers().len();
        // The daemon may just be making a file in it, which is in the way of deleting its directory.
        while let Err(error) = fs::remove_dir_all(bench.path("spool")) {
            assert_eq!(error.kind(), std::io::ErrorKind::DirectoryNotEmpty, "{error}");
        }
        let job = bench.wait_for(id, &["interrupted", "completed", "failed"]);
        assert!(job["state"] == "interrupted" && reason(&job).contains("is no longer there"), "{job}");
        assert!(bench.exposed_layers().len() <= done + 2, "it is noticed at the next record");
        assert!(plate_um(&bench.acts()) >= Some(CLEAR_UM), "{:?}", bench.acts().last());
        // Without its journal it can still be ended, and what is known of its plate is said.
        let answer = bench.json(&[order]);
        assert!(answer["warning"].as_str().is_some_and(|text| text.contains("could not be written")), "{answer}");
        let job = bench.wait_for(id, &[state]);
        assert!(reason(&job).contains("its plate was lifted clear"), "{job}");
        assert!(!reason(&job).contains("not lifted"), "{job}");
    }
}

#[test]
fn a_stop_without_a_journal_leaves_no_part_in_the_vat() {
    let (mut bench, id) = under_light();
    bench.kill_daemon();
    // Its plate stands in the resin, and its journal cannot be read.
    let journal = bench.path("spool/jobs/00000001/journal");
    fs::rename(&journal, bench.path("journal")).expect("renamed");
    fs::create_dir(&journal).expect("a directory instead");
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "interrupted", "{}", bench.job(id));
    let text = refusal(&bench, &["stop", &id.to_string()]);
    assert!(text.contains("it is unknown whether its plate was lifted") && text.contains("layerctl abort"), "{text}");
    let answer = bench.json(&["abort", &id.to_string()]);
    assert!(answer["state"] == "aborted" && reason(&answer).contains("it is unknown"), "{answer}");
    assert!(answer["warning"].as_str().is_some_and(|text| text.contains("could not be written")), "{answer}");
}

#[test]
fn no_news_of_a_queued_job_comes_without_its_reason() {
    let (bench, first) = under_light();
    let news = fs::File::create(bench.path("news")).expect("a file");
    let mut watch = bench.layerctl_command(&["watch", "--json"]).stdout(news).spawn().expect("layerctl starts");
    let told = || fs::read_to_string(bench.path("news")).expect("news");
    wait_until("the first event", || told().contains('\n'));
    let second = bench.start_job("part.layerd").to_string();
    let news_of = |text: &str| -> Vec<Value> {
        let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
        let events = whole.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
        events.filter(|event| event["event"] == "job" && event["id"] == second.as_str()).collect()
    };
    wait_until("news of the job", || !news_of(&told()).is_empty());
    watch.kill().expect("killed");
    watch.wait().expect("waited");
    for job in news_of(&told()) {
        assert!(reason(&job).contains(&format!("waits for the end of job {first}")), "{job}");
    }
    bench.ok(&["abort", &second]);
    bench.ok(&["abort"]);
    bench.wait_for(first, &["aborted"]);
}

#[test]
fn removed_jobs_free_their_room_and_no_other_gets_their_number() {
    let mut bench = Bench::start(Setup::default());
    bench.ok(&SMALL);
    let first = bench.start_job("part.layerd");
    wait_until("its beginning", || bench.job(first)["state"] == "printing");
    let text = refusal(&bench, &["remove", &first.to_string()]);
    assert!(text.contains("only a job that is over") && text.contains("layerctl stop"), "{text}");
    bench.wait_for(first, &["completed"]);
    assert!(refusal(&bench, &["remove", "99"]).contains("there is no job `99`"));
    let told = bench.ok(&["remove", &first.to_string()]);
    assert!(told.contains(&format!("job {first} is removed: ")) && told.contains("iB free again"), "{told}");
    assert_eq!(bench.json(&["jobs"])["jobs"], serde_json::json!([]));
    bench.kill_daemon();
    bench.start_daemon();
    assert_eq!(bench.json(&["jobs"])["jobs"], serde_json::json!([]), "for ever");
    // The device still speaks of the removed job, and the spool still knows its key.
    let second = bench.start_job("part.layerd");
    assert_eq!(second, first + 1);
    bench.wait_for(second, &["completed"]);
}
