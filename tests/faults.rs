//! What goes wrong around a print: the operator is told in one message, no light is left on, nothing is exposed twice or left
//! out, and the next job finds a machine that works.

mod support;

use std::fs;
use std::time::{Duration, Instant};

use support::{Bench, Setup, SmallDisk, signal, skipped, wait_until};

const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];

/// The text with which `layerctl` refuses; nothing but the exit code 1 will do.
fn refusal(bench: &Bench, arguments: &[&str]) -> String {
    let output = bench.layerctl(arguments);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {output:?}");
    String::from_utf8(output.stderr).expect("UTF-8")
}

fn reason(job: &serde_json::Value) -> &str {
    job["reason"].as_str().unwrap_or_default()
}

fn all_layers(job: &serde_json::Value) -> Vec<u64> {
    (0..job["layers_total"].as_u64().expect("layers_total")).collect()
}

#[test]
fn an_abort_before_the_device_is_there_ends_at_once_and_spares_the_next_job() {
    let mut bench = Bench::prepare(Setup::default());
    bench.start_daemon();
    bench.ok(&SMALL);
    let first = bench.start_job("part.layerd");
    bench.wait_for(first, &["checking"]);
    let began = Instant::now();
    bench.ok(&["abort"]);
    let job = bench.wait_for(first, &["aborted"]);
    assert!(began.elapsed() < Duration::from_secs(5), "nobody is waited for: {:?}", began.elapsed());
    assert!(!reason(&job).contains("WARNING"), "no light was ever asked for: {job}");
    let second = bench.start_job("part.layerd");
    bench.start_device();
    let job = bench.wait_for(second, &["completed", "failed", "interrupted"]);
    assert_eq!(job["state"], "completed", "{job}");
}

#[test]
fn an_abort_that_arrives_late_does_not_end_the_next_job() {
    let mut bench = Bench::start(Setup { time_scale: 10, ..Setup::default() });
    bench.ok(&SMALL);
    let first = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(first)["layers_done"].as_u64() >= Some(2));
    signal(bench.device_pid(), "STOP");
    bench.ok(&["abort"]);
    let job = bench.wait_for(first, &["aborted"]);
    assert!(reason(&job).contains("did not confirm that its light is off"), "{job}");
    let second = bench.start_job("part.layerd");
    // Nobody lifted the plate, and a machine that changes plates by itself cannot have changed this one.
    assert!(reason(&bench.job(second)).contains("waits for an empty plate"), "{}", bench.job(second));
    bench.ok(&["resume", &second.to_string()]);
    bench.wait_for(second, &["checking"]);
    signal(bench.device_pid(), "CONT");
    let job = bench.wait_for(second, &["completed", "failed", "interrupted"]);
    assert_eq!(job["state"], "completed", "{job}");
    let exposed = bench.exposed_layers();
    assert_eq!(exposed[exposed.len() - all_layers(&job).len()..], all_layers(&job));
    bench.kill_device();
}

#[test]
fn a_part_damaged_in_the_middle_is_refused_before_the_first_layer() {
    let bench = Bench::start(Setup::default());
    bench.ok(&["generate", "bcc", "--struts", "100000", "--box", "8,8,10", "-o", "part.layerd"]);
    let mut bytes = fs::read(bench.path("part.layerd")).expect("part");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(bench.path("damaged.layerd"), bytes).expect("written");
    let text = refusal(&bench, &["start", "damaged.layerd"]);
    assert!(text.contains("damaged.layerd: chunk ") && text.contains("corrupt"), "{text}");
    assert_eq!(bench.json(&["jobs"])["jobs"], serde_json::json!([]));
    let left = fs::read_dir(bench.path("spool/incoming")).expect("incoming").count();
    assert_eq!(left, 0, "the refused part stays behind");
}

#[test]
fn a_device_switched_off_in_an_exposure_leaves_the_layer_in_doubt() {
    let mut bench = Bench::start(Setup { time_scale: 4, exposure_ms: 4_000, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("a layer", || bench.job(id)["layers_done"].as_u64() >= Some(1));
    wait_until("light", || last_light(&bench) == "light_on");
    let layer = bench.job(id)["layers_done"].clone();
    bench.kill_device();
    bench.start_device();
    let job = bench.wait_for(id, &["completed", "failed", "interrupted"]);
    assert_eq!((&job["state"], &job["in_doubt"]), (&"interrupted".into(), &layer), "{job}");
    let status = bench.ok(&["status"]);
    assert!(status.contains(&format!("layer {layer} may or may not have been exposed")), "the file's number: {status}");
    // The end of a job begins a new session. What the device does not know is known once that is open.
    wait_until("the device", || refusal(&bench, &["resume"]).contains("does not know where its plate is"));
    // Its plate hangs where it hung, but the device does not know where: nothing moves and nothing is exposed.
    for arguments in [&["resume"][..], &["resume", "--in-doubt", "repeat"]] {
        let text = refusal(&bench, arguments);
        assert!(text.contains("does not know where its plate is") && text.contains("layerctl abort 1"), "{text}");
    }
    assert_eq!(bench.job(id)["state"], "interrupted", "{}", bench.job(id));
    assert_eq!(bench.exposed_layers(), Vec::<u64>::new(), "the new device's own log");
}

#[test]
fn a_light_put_off_by_shutdown_is_decided_by_the_operator() {
    for (choice, lights) in [("exposed", 1), ("repeat", 2)] {
        let mut bench = Bench::start(Setup { time_scale: 2, exposure_ms: 90_000, ..Setup::default() });
        bench.ok(&["generate", "bcc", "--struts", "30", "--box", "8,8,1", "-o", "part.layerd"]);
        let id = bench.start_job("part.layerd");
        wait_until("light", || bench.path("device-out/acts.jsonl").exists() && last_light(&bench) == "light_on");
        assert_eq!(bench.terminate_daemon(), Some(0));
        assert_eq!(last_light(&bench), "light_off");
        bench.start_daemon();
        assert_eq!(bench.job(id)["in_doubt"], 0, "{}", bench.job(id));
        bench.ok(&["resume", "--in-doubt", choice]);
        let next = if choice == "exposed" { 1 } else { 0 };
        wait_until("light", || last_light(&bench) == "light_on");
        let acts = bench.acts();
        let on: Vec<_> = acts.iter().filter(|act| act["event"] == "light_on").map(|act| act["layer"].clone()).collect();
        assert_eq!(on.len(), 2);
        assert_eq!(on[1], next, "{choice}: {on:?}");
        assert_eq!(on.iter().filter(|layer| **layer == 0).count(), lights);
        bench.ok(&["abort"]);
        bench.wait_for(id, &["aborted"]);
    }
}

fn last_light(bench: &Bench) -> String {
    let acts = bench.acts();
    let mut lights = acts.iter().rev().filter_map(|act| act["event"].as_str());
    lights.find(|event| event.starts_with("light")).unwrap_or_default().to_owned()
}

#[test]
fn a_full_disk_interrupts_dark_and_the_job_goes_on_once_there_is_room() {
    let mut bench = Bench::prepare(Setup { layer_height_um: 20.0, exposure_ms: 200, ..Setup::default() });
    fs::create_dir(bench.path("spool")).expect("spool");
    let Some(disk) = SmallDisk::mount(&bench.path("spool")) else {
        return skipped("mounting a small disk takes root");
    };
    bench.start_device();
    bench.start_daemon();
    // More layers than the journal has room for beforehand.
    bench.ok(&["generate", "bcc", "--struts", "300", "--box", "8,8,8", "--seed", "1", "-o", "part.layerd"]);
    let id = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(2));
    disk.fill();
    let job = bench.wait_for(id, &["completed", "failed", "interrupted"]);
    assert_eq!(job["state"], "interrupted", "{job}");
    assert!(reason(&job).contains("journal cannot be written") && reason(&job).contains("make room"), "{job}");
    assert!(reason(&job).contains("layerctl remove"), "{job}");
    assert_eq!(last_light(&bench), "light_off");
    let text = refusal(&bench, &["start", "part.layerd"]);
    assert!(text.contains("16.0 MiB must stay free for journals"), "{text}");
    disk.empty();
    bench.ok(&["resume"]);
    let job = bench.wait_for(id, &["completed", "failed", "interrupted"]);
    assert_eq!(job["state"], "completed", "{job}");
    assert_eq!(bench.exposed_layers(), all_layers(&job));
}

#[test]
fn a_build_file_is_never_written_over_its_source() {
    let bench = Bench::prepare(Setup::default());
    let source = "1 0.5 0.15 1\n0 0 0 5 0 5\n";
    fs::write(bench.path("part.txt"), source).expect("part.txt");
    std::os::unix::fs::symlink("part.txt", bench.path("link.layerd")).expect("a link");
    for output in ["link.layerd", "./link.layerd"] {
        let text = refusal(&bench, &["pack", "part.txt", "-o", output]);
        assert!(text.contains("both source and output"), "{text}");
    }
    assert_eq!(fs::read_to_string(bench.path("part.txt")).expect("still there"), source);
}

#[test]
fn a_closed_stdout_ends_a_command_quietly_and_a_full_one_is_an_error() {
    let bench = Bench::prepare(Setup::default());
    bench.ok(&SMALL);
    let (reader, writer) = std::io::pipe().expect("pipe");
    drop(reader);
    let commands: [&[&str]; 3] = [&["info", "part.layerd"], &["info", "part.layerd", "--json"], &SMALL];
    for arguments in commands {
        let mut command = bench.layerctl_command(arguments);
        let output = command.stdout(writer.try_clone().expect("pipe")).output().expect("layerctl runs");
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(141), "as other programs end by SIGPIPE: {arguments:?}: {text}");
        assert!(!text.contains("error") && !text.contains("panicked"), "{arguments:?}: {text}");
        let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("/dev/full");
        let output = bench.layerctl_command(arguments).stdout(full).output().expect("layerctl runs");
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {text}");
        assert!(text.contains("cannot write to stdout"), "{arguments:?}: {text}");
    }
}

#[test]
fn a_device_that_restarts_under_light_can_print_on_once_the_operator_has_decided() {
    let simulate = ["--fault", "reset=2", "--seed", "3"].map(String::from).to_vec();
    // Light of 350 ms on the wall's clock: a reset comes within 300 ms of its beginning.
    let bench = Bench::start(Setup { time_scale: 10, exposure_ms: 3_500, simulate, ..Setup::default() });
    bench.ok(&["generate", "bcc", "--struts", "30", "--box", "8,8,1", "-o", "part.layerd"]);
    let id = bench.start_job("part.layerd");
    let mut decided = Vec::new();
    let job = loop {
        let job = bench.wait_for(id, &["completed", "failed", "interrupted"]);
        if job["state"] != "interrupted" {
            break job;
        }
        let layer = job["in_doubt"].as_u64().unwrap_or_else(|| panic!("a layer in doubt: {job}"));
        let refused = refusal(&bench, &["resume", &id.to_string()]);
        assert!(refused.contains("--in-doubt exposed") && refused.contains("--in-doubt repeat"), "{refused}");
        bench.ok(&["resume", &id.to_string(), "--in-doubt", "repeat"]);
        decided.push(layer);
        assert!(decided.len() <= 2, "{job}");
    };
    assert_eq!(job["state"], "completed", "{job}");
    assert_eq!(decided.len(), 2, "both resets fell into an exposure");
    assert_eq!(bench.exposed_layers(), all_layers(&job), "each layer had its whole time once; in doubt: {decided:?}");
}
