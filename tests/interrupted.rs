//! Light that is on when the daemon is killed or ends, and what switches it off.

mod support;

use std::time::Duration;

use serde_json::Value;
use support::{Bench, Setup, signal, wait_until};

const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];

/// `clear_height_um` of the bench's machine.
const CLEAR_UM: i64 = 30_000;

/// A print whose first layer has light for some seconds.
fn under_light(confirm_plate: bool) -> (Bench, u64) {
    let bench = Bench::start(Setup { exposure_ms: 24_000, time_scale: 4, confirm_plate, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("light", || has(&bench.acts(), "light_on"));
    (bench, id)
}

/// The same after the daemon was killed and started again: the device goes on exposing.
fn killed_under_light(confirm_plate: bool) -> (Bench, u64) {
    let (mut bench, id) = under_light(confirm_plate);
    bench.kill_daemon();
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "interrupted");
    (bench, id)
}

fn has(acts: &[Value], event: &str) -> bool {
    acts.iter().any(|act| act["event"] == event)
}

/// Where the plate came to rest last.
fn plate_um(acts: &[Value]) -> Option<i64> {
    acts.iter().rev().find(|act| act["event"] == "moved").and_then(|act| act["position_um"].as_i64())
}

#[test]
fn abort_puts_its_light_off_and_lifts() {
    let (bench, id) = killed_under_light(false);
    bench.ok(&["abort"]);
    let job = bench.wait_for(id, &["aborted", "interrupted", "failed"]);
    assert_eq!(job["state"], "aborted", "{job}");
    let acts = bench.acts();
    assert!(has(&acts, "light_off") && !has(&acts, "exposed"), "{acts:?}");
    assert_eq!(plate_um(&acts), Some(CLEAR_UM), "{acts:?}");
}

#[test]
fn stop_lets_its_layer_end_and_lifts() {
    let (bench, id) = killed_under_light(false);
    bench.ok(&["stop"]);
    let job = bench.wait_for(id, &["stopped", "interrupted", "failed"]);
    assert_eq!((&job["state"], &job["layers_done"]), (&"stopped".into(), &1.into()), "{job}");
    let acts = bench.acts();
    assert!(has(&acts, "exposed"), "{acts:?}");
    assert_eq!(plate_um(&acts), Some(CLEAR_UM), "{acts:?}");
}

#[test]
fn abort_of_a_job_whose_part_is_gone_still_puts_its_light_off() {
    let (bench, id) = killed_under_light(true);
    std::fs::remove_file(bench.path(&format!("spool/jobs/{id:08}/part.layerd"))).expect("the spool's copy");
    bench.ok(&["abort"]);
    let job = bench.wait_for(id, &["aborted", "failed"]);
    let reason = job["reason"].as_str().unwrap_or_default();
    assert!(job["state"] == "aborted" && reason.contains("plate was not lifted"), "{job}");
    wait_until("the light off", || has(&bench.acts(), "light_off"));
    assert!(!has(&bench.acts(), "exposed"), "{:?}", bench.acts());
    // Its part is still there: the next job begins only on a word.
    std::fs::copy(bench.path("part.layerd"), bench.path("next.layerd")).expect("copied");
    let acts = bench.acts().len();
    let next = bench.start_job("next.layerd");
    let reason = bench.job(next)["reason"].clone();
    assert!(reason.as_str().is_some_and(|reason| reason.contains("waits for an empty plate")), "{reason}");
    assert_eq!(bench.acts()[acts..].iter().find(|act| act["event"] == "moved"), None);
}

#[test]
fn abort_without_a_job_puts_the_light_off() {
    let (mut bench, _) = killed_under_light(false);
    bench.kill_daemon();
    std::fs::remove_dir_all(bench.path("spool")).expect("the spool");
    bench.start_daemon();
    let output = bench.layerctl(&["abort"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && told.contains("no job is active") && told.contains("go dark"), "{told}");
    wait_until("the light off", || has(&bench.acts(), "light_off"));
    assert!(!has(&bench.acts(), "exposed"), "{:?}", bench.acts());
}

#[test]
fn abort_without_a_device_ends_the_job_with_a_warning() {
    let (mut bench, id) = killed_under_light(false);
    bench.kill_device();
    std::thread::sleep(Duration::from_millis(200));
    bench.ok(&["abort"]);
    let job = bench.wait_for(id, &["aborted", "interrupted", "failed"]);
    let reason = job["reason"].as_str().unwrap_or_default();
    assert!(job["state"] == "aborted" && reason.contains("did not confirm that its light is off"), "{job}");
}

#[test]
fn abort_gets_through_to_a_daemon_that_ends() {
    let (mut bench, id) = under_light(false);
    signal(bench.daemon_pid(), "TERM");
    std::thread::sleep(Duration::from_millis(300));
    let later = "the daemon is stopping; resume once it runs again";
    wait_until("the reason", || bench.job(id)["reason"] == later);
    for arguments in [&["resume", "1"][..], &["resume"]] {
        let output = bench.layerctl(arguments);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && text.contains(later) && !text.contains("it the"), "{text}");
    }
    bench.ok(&["abort"]);
    assert_eq!(bench.wait_daemon(), Some(0));
    let acts = bench.acts();
    assert!(has(&acts, "light_off") && !has(&acts, "exposed"), "{acts:?}");
    assert_eq!(plate_um(&acts), Some(CLEAR_UM), "{acts:?}");
    bench.start_daemon();
    let state = bench.job(id)["state"].clone();
    assert!(state == "aborted" || state == "interrupted", "{state}");
}

#[test]
fn the_device_is_seen_to_shine_while_it_does() {
    let (bench, _) = under_light(false);
    wait_until("`device` says so", || bench.json(&["device"])["state"]["light_on"] == true);
    assert!(!has(&bench.acts(), "light_off"), "it was seen in time");
    bench.ok(&["abort"]);
    wait_until("`device` says that it is dark", || bench.json(&["device"])["state"]["light_on"] == false);
}
