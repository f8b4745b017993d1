//! What an operator reads and types at a daemon that prints, is busy, hangs, or has ended a job: real processes throughout.

mod again;
mod records;
#[path = "../support/mod.rs"]
mod support;

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use support::{Bench, Setup, signal, wait_until};

/// 24 layers; with the exposures of [`slowly`] there is time to look.
const PART: [&str; 8] = ["generate", "bcc", "--struts", "60", "--box", "6,6,2", "-o", "part.layerd"];

/// Layers of a second each.
fn slowly() -> Setup {
    Setup { exposure_ms: 1000, time_scale: 1, ..Setup::default() }
}

fn spawn(bench: &Bench, arguments: &[&str]) -> Child {
    let mut command = bench.layerctl_command(arguments);
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("layerctl starts")
}

/// Stops a process, and waits until each of its threads stands still: on a busy machine some of them run on for a while.
fn stop(pid: u32) {
    signal(pid, "STOP");
    let is_stopped =
        |task: std::path::PathBuf| std::fs::read_to_string(task.join("stat")).is_ok_and(|stat| stat.contains(") T "));
    wait_until("a process that stands still", || {
        let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).expect("it runs");
        tasks.map(|task| task.expect("a task").path()).all(is_stopped)
    });
}

/// Exit code and standard error of a command that ends.
fn ended(child: Child) -> (Option<i32>, String) {
    let output = child.wait_with_output().expect("layerctl ends");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Reads standard error to the first line with these words.
fn read_until(child: &mut Child, words: &str) -> String {
    let mut stderr = BufReader::new(child.stderr.as_mut().expect("piped"));
    let mut text = String::new();
    while !text.contains(words) {
        let count = stderr.read_line(&mut text).expect("readable");
        assert!(count > 0, "`{words}` is not in {text}");
    }
    text
}

#[test]
fn a_daemon_that_hangs_is_told_after_two_seconds_and_an_abort_waits_for_it() {
    let bench = Bench::start(slowly());
    bench.ok(&PART);
    let id = bench.start_job("part.layerd");
    bench.wait_for(id, &["printing"]);
    stop(bench.daemon_pid());
    let began = Instant::now();
    let mut abort = spawn(&bench, &["abort"]);
    let commands: [&[&str]; 5] =
        [&["status"], &["jobs", "--json"], &["device"], &["watch", "--json"], &["start", "part.layerd", "--wait"]];
    let children: Vec<_> = commands.iter().map(|arguments| spawn(&bench, arguments)).collect();
    let told = read_until(&mut abort, "\n");
    let waited = began.elapsed();
    assert!(
        told.contains("has not answered for 2 s") && told.contains("switch the printer off at the mains"),
        "{told}"
    );
    assert!(waited >= Duration::from_secs(2), "{waited:?}");
    for (arguments, child) in commands.iter().zip(children) {
        let (code, told) = ended(child);
        assert_eq!(code, Some(1), "{arguments:?}: {told}");
        let mut lines = told.lines();
        let (first, last) = (lines.next().unwrap_or_default(), lines.next().unwrap_or_default());
        assert!(first.contains("has not answered for 2 s: waiting 3 s more"), "{arguments:?}: {told}");
        assert!(
            last.contains("did not answer within 5 s") && last.contains("log may tell why"),
            "{arguments:?}: {told}"
        );
    }
    for order in ["pause", "resume", "stop"] {
        let mut order = spawn(&bench, &[order]);
        let told = read_until(&mut order, "\n");
        assert!(told.contains("28 s more before the order can be given; it is not given yet"), "{told}");
        order.kill().expect("ends");
        order.wait().expect("has ended");
    }
    signal(bench.daemon_pid(), "CONT");
    let (code, told) = ended(abort);
    assert_eq!(code, Some(0), "{told}");
    bench.wait_for(id, &["aborted"]);
}

#[test]
fn without_a_terminal_each_state_is_told_once_and_in_order() {
    let bench = Bench::start(Setup::default());
    bench.ok(&PART);
    let output = bench.layerctl(&["start", "part.layerd", "--wait"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    let progress = told.lines().filter(|line| line.contains(" layers done"));
    let lines = progress.filter_map(|line| line.strip_prefix("job 1 ")?.split_once(": "));
    let states: Vec<&str> = lines.map(|(state, _)| state).collect();
    let in_order: Vec<&str> =
        ["queued", "checking", "printing", "completed"].into_iter().filter(|state| states.contains(state)).collect();
    assert!(states == in_order && states.last() == Some(&"completed"), "{told}");
}

#[test]
fn news_that_stop_coming_are_told() {
    let bench = Bench::start(slowly());
    bench.ok(&PART);
    let mut start = spawn(&bench, &["start", "part.layerd", "--wait"]);
    read_until(&mut start, "printing");
    stop(bench.daemon_pid());
    read_until(&mut start, "silent for 2 s");
    signal(bench.daemon_pid(), "CONT");
    read_until(&mut start, "layerd goes on");
    bench.ok(&["abort"]);
    let (code, told) = ended(start);
    assert!(code == Some(3) && told.contains("layers done"), "{told}");
}

#[test]
fn start_says_what_a_job_waits_for() {
    let mut bench = Bench::prepare(slowly());
    bench.start_daemon();
    bench.ok(&PART);
    let output = bench.layerctl(&["start", "part.layerd"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && output.stdout == b"1\n", "the id alone stands on stdout: {output:?}");
    assert!(told.contains("no device answers yet: ") && told.contains("Job 1 waits a minute"), "{told}");
    bench.start_device();
    bench.wait_for(1, &["printing"]);
    let output = bench.layerctl(&["start", "part.layerd"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.stdout == b"2\n" && told == "job 2 waits for the end of job 1\n", "{told}");
}

#[test]
fn ctrl_c_ends_the_command_and_not_the_print() {
    let bench = Bench::start(slowly());
    bench.ok(&PART);
    let mut start = spawn(&bench, &["start", "part.layerd", "--wait"]);
    let told = read_until(&mut start, "layers done");
    assert!(told.contains("job 1 ") && told.contains(" of 24 layers done"), "no terminal, so lines: {told}");
    bench.wait_for(1, &["printing"]);
    signal(start.id(), "INT");
    let (code, told) = ended(start);
    assert_eq!(code, Some(130), "{told}");
    assert!(told.contains("job 1 goes on without this command") && told.contains("layerctl abort 1"), "{told}");
    assert_eq!(bench.job(1)["state"], "printing");
}

#[test]
fn layers_have_one_numbering_and_the_job_that_ended_last_is_shown() {
    let bench = Bench::start(Setup { exposure_ms: 3000, time_scale: 10, ..Setup::default() });
    bench.ok(&PART);
    let status = bench.ok(&["status"]);
    assert!(!status.contains("last "), "nothing has ended: {status}");
    let id = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(2));
    for command in ["status", "jobs"] {
        let told = bench.ok(&[command]);
        assert!(told.contains(" s to go, until about 20") && told.contains(" UTC"), "{told}");
    }
    assert!(bench.ok(&["pause"]).contains("after the layer under way"));
    // Pausing takes as long as the layer under way.
    assert_eq!(bench.ok(&["resume"]), "job 1 goes on\n");
    bench.ok(&["pause"]);
    bench.wait_for(id, &["paused"]);
    let exposed = bench.exposed_layers();
    let done = exposed.len();
    assert_eq!(exposed.last(), Some(&(done as u64 - 1)), "layers count from 0");
    assert_eq!(bench.job(id)["layer"], done, "the next layer's number is the count of those done");
    let count = format!("{done} of 24 layers done");
    assert!(bench.ok(&["status"]).contains(&count), "{}", bench.ok(&["status"]));
    assert!(bench.ok(&["jobs"]).contains(&format!("{done}/24")), "{}", bench.ok(&["jobs"]));
    let share = format!("{count} ({} %), ", 100 * done / 24);
    for command in ["status", "jobs"] {
        let told = bench.ok(&[command]);
        assert!(told.contains(&share) && told.contains(" s ago"), "`{share}` is not in {told}");
    }
    assert!(bench.ok(&["device"]).contains(&format!("exposed    layer {} of job 1", done - 1)));
    bench.ok(&["stop"]);
    bench.wait_for(id, &["stopped"]);
    let status = bench.ok(&["status"]);
    for words in ["last     1 part.layerd: stopped", " s ago (20", " UTC)", &count, "stopped by the operator"] {
        assert!(status.contains(words), "`{words}` is not in {status}");
    }
    assert_eq!(bench.json(&["status"])["last"]["id"], "1");
}

#[test]
fn what_cannot_be_done_is_said_in_a_sentence_that_helps() {
    let bench = Bench::start(Setup { exposure_ms: 3000, time_scale: 10, confirm_plate: true, ..Setup::default() });
    bench.ok(&PART);
    let refused = |arguments: &[&str], words: &[&str]| {
        let output = bench.layerctl(arguments);
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {told}");
        for words in words {
            assert!(told.contains(words), "{arguments:?}: `{words}` is not in {told}");
        }
        assert!(!told.contains("cannot be"), "{arguments:?}: {told}");
    };
    refused(&["resume"], &["no job is paused or interrupted"]);
    let first = bench.start_job("part.layerd");
    let output = bench.layerctl(&["start", "part.layerd"]);
    assert!(output.status.success(), "{output:?}");
    bench.wait_for(first, &["printing"]);
    refused(&["resume", "1"], &["job 1 is printing: there is nothing to resume"]);
    refused(&["resume"], &["no job is paused or interrupted; job 1 is printing"]);
    refused(&["pause", "2"], &["job 2 has not begun", "layerctl stop 2"]);
    bench.ok(&["pause"]);
    bench.wait_for(first, &["paused"]);
    refused(&["pause"], &["job 1 is paused already", "layerctl resume 1"]);
    bench.ok(&["abort"]);
    bench.wait_for(first, &["aborted"]);
    refused(&["abort", "1"], &["job 1 is over (aborted): there is nothing to abort"]);
    refused(&["resume", "1"], &["job 1 is over (aborted); start the part again"]);
    wait_until("the question for the plate", || {
        bench.job(2)["reason"].as_str().is_some_and(|reason| reason.contains("empty plate"))
    });
    refused(&["resume"], &["job 2 is queued: it waits for an empty plate", "layerctl resume 2"]);
    assert_eq!(bench.ok(&["resume", "2"]), "job 2 begins: the plate is confirmed to be empty\n");
    bench.wait_for(2, &["printing"]);
}

#[test]
fn an_abort_says_which_job_it_ends_and_leaves_the_queue() {
    let bench = Bench::start(Setup { confirm_plate: true, ..slowly() });
    bench.ok(&PART);
    let first = bench.start_job("part.layerd");
    bench.wait_for(first, &["printing"]);
    bench.start_job("part.layerd");
    let told = bench.ok(&["abort"]);
    // A device that is quick has ended it before the answer.
    assert!(told.starts_with("job 1 (part.layerd) is ") && told.contains("aborted"), "{told}");
    bench.wait_for(first, &["aborted"]);
    assert_eq!(bench.job(2)["state"], "queued");
    assert_eq!(bench.ok(&["abort", "2"]), "job 2 (part.layerd) is aborted\n");
}

#[test]
fn suggested_commands_name_the_socket_that_was_given() {
    let bench = Bench::start(slowly());
    let socket = bench.path("control.sock").display().to_string();
    for arguments in [["--socket", &socket, "jobs"], ["jobs", "--socket", &socket]] {
        let output = bench.layerctl_command(&arguments).env("LAYERD_SOCKET", "/nonexistent").output().expect("runs");
        let told = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{output:?}");
        assert!(told.contains(&format!("`layerctl --socket {socket} start FILE`")), "{told}");
    }
    let output = bench.layerctl(&["--socket", "/tmp/no such.sock", "status"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(told.contains("/tmp/no such.sock") && told.contains("layerd --config FILE"), "{told}");
    let told = bench.ok(&["jobs"]);
    assert!(told.contains("`layerctl start FILE`"), "in the environment it is there for the next command: {told}");
}

#[test]
fn a_damaged_copy_in_the_spool_is_told_as_that() {
    let bench = Bench::start(slowly());
    bench.ok(&PART);
    bench.start_job("part.layerd");
    bench.wait_for(1, &["printing"]);
    bench.start_job("part.layerd");
    let copy = bench.path("spool/jobs/00000002/part.layerd");
    let mut bytes = std::fs::read(&copy).expect("the copy");
    // A byte of the last chunk: header, index and footer stay whole.
    let at = bytes.len() / 2;
    bytes[at] ^= 0x55;
    std::fs::write(&copy, bytes).expect("damaged");
    bench.ok(&["abort"]);
    let job = bench.wait_for(2, &["failed", "interrupted", "completed"]);
    let reason = job["reason"].as_str().expect("a reason");
    assert!(reason.contains("the spool's copy of the part is damaged (chunk 0 of 1"), "{reason}");
    assert!(reason.contains("from its original file") && !reason.contains("pack the part again"), "{reason}");
}

#[test]
fn orders_promise_nothing_while_the_device_does_not_answer() {
    let mut bench = Bench::start(slowly());
    bench.ok(&PART);
    let id = bench.start_job("part.layerd");
    wait_until("some layers", || bench.job(id)["layers_done"].as_u64() >= Some(2));
    bench.kill_device();
    wait_until("the line is lost", || bench.json(&["status"])["link"]["state"] != "connected");
    for command in ["status", "jobs"] {
        let told = bench.ok(&[command]);
        assert!(told.contains(" of 24 layers done (") && !told.contains(" to go"), "nothing goes on: {told}");
    }
    let told = bench.ok(&["pause"]);
    assert!(
        told.contains("is accepted, and will be carried out when the device answers: the device does not answer now"),
        "{told}"
    );
    let told = bench.ok(&["abort"]);
    assert!(told.starts_with("If there is light or the plate moves, switch the printer off at the mains"), "{told}");
    assert!(told.contains("It will abort job 1 (part.layerd)") && !told.contains("goes off first"), "{told}");
    let status = bench.ok(&["status"]);
    assert!(status.contains("aborting") && status.contains("switch the printer off at the mains"), "{status}");
}

#[test]
fn a_job_that_begins_at_once_says_what_the_plate_is_taken_to_be() {
    let bench = Bench::start(Setup { confirm_plate: true, ..Setup::default() });
    bench.ok(&PART);
    wait_until("the device", || bench.json(&["status"])["link"]["state"] == "connected");
    for (id, told) in [(1, "empty\n"), (2, "empty (the last job, 1, completed)\n")] {
        let output = bench.layerctl(&["start", "part.layerd", "--wait"]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        let told = format!("job {id} begins at once: the plate is taken to be {told}");
        assert!(output.status.success() && text.matches(&told).count() == 1, "{text}");
        let log = std::fs::read_to_string(bench.path("daemon.log")).expect("log");
        let (said, begun) = (log.find(told.trim_end()), log.find(&format!("job begins job={id}")));
        assert!(said.is_some() && said < begun, "{log}");
    }
}

#[test]
fn jobs_that_cannot_be_removed_do_not_keep_others_and_a_plate_is_only_taken_to_be_empty() {
    let bench = Bench::start(slowly());
    bench.ok(&PART);
    let id = bench.start_job("part.layerd");
    bench.wait_for(id, &["printing"]);
    let told = bench.ok(&["abort"]);
    assert!(!told.contains("does not answer"), "a device that took the abort comes back at once: {told}");
    bench.wait_for(id, &["aborted"]);
    wait_until("the device is back", || bench.json(&["status"])["link"]["state"] == "connected");
    let output = bench.layerctl(&["start", "part.layerd"]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        told.contains("job 2 begins at once: the plate is taken to be empty (the last job, 1, was aborted)"),
        "{told}"
    );
    bench.ok(&["abort"]);
    bench.wait_for(2, &["aborted"]);
    let output = bench.layerctl(&["remove", "77", "1", "2"]);
    let (out, told) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(told.contains("no job `77`") && out.contains("job 1 is removed: ") && out.contains("job 2 is removed: "));
    assert!(out.lines().all(|line| line.ends_with("iB free again")), "{out}");
    assert!(bench.ok(&["jobs"]).contains("no jobs remembered"));
}
