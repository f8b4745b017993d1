//! Parts that no record here accounts for: the plate goes down only on the operator's word, and can be raised without a job.

mod support;

use std::fs;
use std::os::unix::fs::symlink;

use serde_json::Value;
use support::{Bench, Setup, signal, wait_until};

const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];

/// `clear_height_um` of the bench's machine.
const CLEAR_UM: i64 = 30_000;

/// A bench with a part, whose device stands in the resin after some layers of a job whose daemon was killed.
fn part_in_the_vat() -> Bench {
    let mut bench = Bench::start(Setup { exposure_ms: 2000, time_scale: 20, ..Setup::default() });
    bench.ok(&SMALL);
    bench.start_and_kill();
    bench
}

fn reason(job: &Value) -> String {
    job["reason"].as_str().unwrap_or_default().to_owned()
}

fn moves(bench: &Bench) -> usize {
    bench.acts().iter().filter(|act| act["event"] == "moved").count()
}

fn plate_um(bench: &Bench) -> Option<i64> {
    bench.acts().iter().rev().find(|act| act["event"] == "moved").and_then(|act| act["position_um"].as_i64())
}

fn refusal(bench: &Bench, arguments: &[&str]) -> String {
    let output = bench.layerctl(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {output:?}");
    String::from_utf8(output.stderr).expect("UTF-8")
}

#[test]
fn a_new_spool_does_not_print_onto_a_part_it_does_not_know() {
    let mut bench = part_in_the_vat();
    fs::remove_dir_all(bench.path("spool")).expect("the spool");
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    let (before, lit) = (moves(&bench), bench.exposed_layers().len());
    let id = bench.start_job("part.layerd");
    wait_until("the question", || reason(&bench.job(id)).contains("waits for an empty plate"));
    let told = reason(&bench.job(id));
    assert!(told.contains("the device last exposed layer") && told.contains("does not know"), "{told}");
    assert!(told.contains("mm above the vat, below the clear height of 30.000 mm"), "{told}");
    assert!(told.contains(&format!("layerctl resume {id}")), "{told}");
    std::thread::sleep(std::time::Duration::from_millis(500));
    assert_eq!((moves(&bench), bench.exposed_layers().len()), (before, lit), "nothing moves, nothing is lit");
    assert_eq!(bench.job(id)["state"], "queued");
    bench.ok(&["resume", &id.to_string()]);
    bench.wait_for(id, &["completed"]);
    // Its part was lifted, and the word is remembered: neither the next job nor the next daemon asks again.
    let next = bench.start_job("part.layerd");
    bench.wait_for(next, &["completed"]);
    bench.kill_daemon();
    bench.start_daemon();
    let next = bench.start_job("part.layerd");
    bench.wait_for(next, &["completed"]);
}

#[test]
fn a_layer_cut_short_for_an_unknown_job_is_asked_about_once() {
    let mut bench = Bench::start(Setup { exposure_ms: 8000, time_scale: 20, ..Setup::default() });
    bench.ok(&SMALL);
    let first = bench.start_job("part.layerd");
    wait_until("light", || bench.acts().iter().any(|act| act["event"] == "light_on"));
    bench.ok(&["abort"]);
    bench.wait_for(first, &["aborted"]);
    bench.kill_daemon();
    fs::remove_dir_all(bench.path("spool")).expect("the spool");
    fs::write(
        bench.path("recipe.toml"),
        fs::read_to_string(bench.path("recipe.toml")).expect("recipe").replace("8000", "400"),
    )
    .expect("a faster recipe");
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    let id = bench.start_job("part.layerd");
    wait_until("the question", || reason(&bench.job(id)).contains("cut short the light of layer 0"));
    let told = reason(&bench.job(id));
    assert!(!told.contains("mm above the vat"), "the abort lifted it: {told}");
    bench.ok(&["resume", &id.to_string()]);
    bench.wait_for(id, &["completed"]);
    // The device tells of it for ever, and the operator knows.
    bench.kill_daemon();
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["state"]["cut_short"]["layer"] == 0);
    let next = bench.start_job("part.layerd");
    bench.wait_for(next, &["completed"]);
}

#[test]
fn a_job_that_was_there_before_the_device_looks_at_its_plate_first() {
    let mut bench = part_in_the_vat();
    fs::remove_dir_all(bench.path("spool")).expect("the spool");
    signal(bench.device_pid(), "STOP");
    bench.start_daemon();
    let id = bench.start_job("part.layerd");
    wait_until("its wait for the device", || bench.job(id)["state"] == "checking");
    let before = moves(&bench);
    signal(bench.device_pid(), "CONT");
    wait_until("the question", || reason(&bench.job(id)).contains("the device last exposed layer"));
    let job = bench.job(id);
    assert!(job["state"] == "queued" && job["started_ms"].is_null(), "{job}");
    std::thread::sleep(std::time::Duration::from_millis(300));
    assert_eq!(moves(&bench), before);
    bench.ok(&["resume", &id.to_string()]);
    bench.wait_for(id, &["completed"]);
}

#[test]
fn a_device_put_in_place_of_another_is_looked_at_before_the_plate_goes_down() {
    let other = part_in_the_vat();
    // Slow enough to be caught while it homes; the other one is as fast as the machine file says.
    let mut bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    let machine = std::fs::read_to_string(bench.path("machine.toml")).expect("a machine");
    std::fs::write(bench.path("machine.toml"), machine.replace("time_scale = 1.0", "time_scale = 20.0"))
        .expect("written");
    bench.start_device();
    bench.start_daemon();
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("homing", || bench.json(&["device"])["state"]["moving"] == true);
    bench.kill_device();
    let (before, lit) = (moves(&other), other.exposed_layers().len());
    symlink(other.path("device"), bench.path("device")).expect("another device");
    let job = bench.wait_for(id, &["interrupted", "completed", "failed"]);
    assert!(reason(&job).contains("the device last exposed layer"), "{job}");
    assert_eq!((moves(&other), other.exposed_layers().len()), (before, lit), "nothing moves, nothing is lit");
    bench.ok(&["resume", &id.to_string()]);
    let job = bench.wait_for(id, &["completed", "failed", "interrupted"]);
    assert_eq!(job["state"], "completed", "{job}");
}

#[test]
fn a_job_killed_before_its_first_light_goes_on_without_a_question() {
    let mut bench = Bench::start(Setup { time_scale: 1, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("homing", || bench.json(&["device"])["state"]["moving"] == true);
    bench.kill_daemon();
    wait_until("the plate at the bottom", || plate_um(&bench) == Some(0));
    bench.start_daemon();
    bench.ok(&["resume", &id.to_string()]);
    wait_until("light", || bench.acts().iter().any(|act| act["event"] == "light_on"));
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
}

#[test]
fn a_plate_that_nothing_else_lifts_is_raised_and_its_part_still_asked_for() {
    let mut bench = part_in_the_vat();
    let journal = bench.path("spool/jobs/00000001/journal");
    let mut bytes = fs::read(&journal).expect("the journal");
    bytes[40] ^= 1;
    fs::write(&journal, bytes).expect("damaged");
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    assert_eq!(bench.job(1)["state"], "failed", "{}", bench.job(1));
    let told = bench.ok(&["raise"]);
    assert!(told.contains("30.000 mm above the vat"), "{told}");
    wait_until("the plate above", || plate_um(&bench) == Some(CLEAR_UM));
    wait_until("its end", || bench.json(&["device"])["state"]["position_um"] == CLEAR_UM);
    assert!(bench.ok(&["raise"]).contains("already clear of the resin"));
    let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
    assert!(log.contains("the plate is raised"), "{log}");
    let id = bench.start_job("part.layerd");
    let told = reason(&bench.job(id));
    assert!(told.contains("no record says that the plate was lifted at the end of job 1"), "{told}");
    assert!(told.contains("the plate was raised from") && !told.contains("below the clear height"), "{told}");
}

/// The device lost its power as well: nothing but the spool knows that something hangs there.
#[test]
fn a_raised_plate_is_asked_about_after_a_restart_until_it_is_said_to_be_clear() {
    let mut bench = part_in_the_vat();
    fs::remove_dir_all(bench.path("spool")).expect("the spool");
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    bench.ok(&["raise"]);
    assert!(bench.path("spool/raised").exists(), "the note comes before the move, and the move before the answer");
    wait_until("the plate above", || plate_um(&bench) == Some(CLEAR_UM));
    bench.kill_daemon();
    bench.kill_device();
    bench.start_device();
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    let id = bench.start_job("part.layerd");
    wait_until("the question", || reason(&bench.job(id)).contains("waits for an empty plate"));
    let told = reason(&bench.job(id));
    assert!(told.contains("the plate was raised from") && !told.contains("last exposed"), "{told}");
    bench.ok(&["resume", &id.to_string()]);
    wait_until("its beginning", || bench.job(id)["state"] != "queued");
    wait_until("the note is gone", || !bench.path("spool/raised").exists());
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
    // What cannot be read is asked about, too.
    fs::write(bench.path("spool/raised"), "high").expect("written");
    bench.kill_daemon();
    bench.start_daemon();
    let next = bench.start_job("part.layerd");
    wait_until("the question", || reason(&bench.job(next)).contains("the plate was raised from"));
}

#[test]
fn a_plate_raised_under_an_interrupted_job_is_not_asked_about_after_that_job() {
    let mut bench = part_in_the_vat();
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    assert_eq!(bench.job(1)["state"], "interrupted");
    bench.ok(&["raise"]);
    wait_until("the plate above", || plate_um(&bench) == Some(CLEAR_UM));
    assert!(bench.path("spool/raised").exists());
    bench.ok(&["abort", "1"]);
    bench.wait_for(1, &["aborted"]);
    wait_until("the note is gone", || !bench.path("spool/raised").exists());
    let next = bench.start_job("part.layerd");
    wait_until("its beginning", || bench.job(next)["state"] != "queued");
}

#[test]
fn the_plate_is_not_raised_beside_a_job_or_from_an_unknown_height() {
    let bench = Bench::start(Setup { time_scale: 4, exposure_ms: 4000, ..Setup::default() });
    bench.ok(&SMALL);
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    let text = refusal(&bench, &["raise"]);
    assert!(text.contains("does not know where its plate is") && text.contains("by hand"), "{text}");
    let id = bench.start_job("part.layerd");
    wait_until("light", || bench.acts().iter().any(|act| act["event"] == "light_on"));
    let text = refusal(&bench, &["raise"]);
    assert!(text.contains(&format!("job {id} has the machine")) && text.contains("layerctl pause"), "{text}");
    bench.ok(&["abort"]);
    bench.wait_for(id, &["aborted"]);
}

#[test]
fn an_abort_stops_a_plate_that_is_raised() {
    // A lift of 30 mm at 20 mm/s, four times slower than real: long enough to be caught.
    let mut bench = part_in_the_vat();
    fs::remove_dir_all(bench.path("spool")).expect("the spool");
    let recipe = fs::read_to_string(bench.path("recipe.toml")).expect("recipe");
    fs::write(bench.path("recipe.toml"), recipe.replace("lift_speed_um_s = 20000", "lift_speed_um_s = 200"))
        .expect("slower");
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    bench.ok(&["raise"]);
    wait_until("the move", || bench.json(&["device"])["state"]["moving"] == true);
    let text = refusal(&bench, &["abort"]);
    assert!(text.contains("no job is active") && text.contains("go dark at once"), "{text}");
    assert!(text.contains("`layerctl device`"), "{text}");
    wait_until("the stop", || bench.acts().iter().any(|act| act["event"] == "moved" && act["reason"] == "stopped"));
    assert!(plate_um(&bench) < Some(CLEAR_UM), "{:?}", plate_um(&bench));
    wait_until("the device again", || bench.json(&["device"])["state"]["moving"] == false);
    wait_until("raising again", || bench.layerctl(&["raise"]).status.success());
}

/// A power cut, another board, `raise`: the device shows the sign no more, and the part hangs where it hung.
#[test]
fn a_sign_that_was_told_waits_for_the_word_though_it_vanishes() {
    let mut bench = part_in_the_vat();
    fs::remove_dir_all(bench.path("spool")).expect("the spool");
    bench.start_daemon();
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    let id = bench.start_job("part.layerd");
    wait_until("the question", || reason(&bench.job(id)).contains("the device last exposed layer"));
    // One that knows nothing of exposures, nor where its plate is.
    bench.kill_device();
    wait_until("it is gone", || bench.json(&["device"])["connected"] == false);
    bench.start_device();
    wait_until("the new device", || bench.json(&["device"])["connected"] == true);
    let (before, acts) = (moves(&bench), bench.acts().len());
    std::thread::sleep(std::time::Duration::from_millis(1500));
    let job = bench.job(id);
    assert_eq!(job["state"], "queued", "{job}");
    assert!(reason(&job).contains("the device last exposed layer"), "{job}");
    assert_eq!((moves(&bench), bench.acts().len()), (before, acts), "nothing is commanded");
    bench.ok(&["resume", &id.to_string()]);
    bench.wait_for(id, &["completed"]);
}
