//! Files of the spool that are replaced by a pipe or by a link to an endless device: the daemon never waits for them and never
//! reads them without end.

mod support;

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use support::{Bench, Setup, wait_until};

const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];

/// Runs the daemon with this much address space, KiB: four times what it needs here, and reached at once by an endless file.
const ULIMIT: &str = "ulimit -v 2000000; exec \"$0\" \"$@\"";

fn replace_by_pipe(path: &Path) {
    let _ = fs::remove_file(path);
    assert!(Command::new("mkfifo").arg(path).status().expect("mkfifo runs").success());
}

fn replace_by_endless_device(path: &Path) {
    let _ = fs::remove_file(path);
    symlink("/dev/zero", path).expect("a link");
}

const REPLACEMENTS: [fn(&Path); 2] = [replace_by_pipe, replace_by_endless_device];

fn limited(bench: &Bench) -> Command {
    bench.daemon_command(&["sh", "-c", ULIMIT, env!("CARGO_BIN_EXE_layerd")])
}

/// A bench with a job whose daemon was killed in the middle of it.
fn interrupted() -> Bench {
    let mut bench = Bench::start(Setup { exposure_ms: 2000, time_scale: 20, ..Setup::default() });
    bench.ok(&SMALL);
    bench.start_and_kill();
    bench
}

fn reason(job: &Value) -> &str {
    job["reason"].as_str().unwrap_or_default()
}

#[test]
fn the_note_of_a_raised_plate_is_asked_about_and_holds_nothing_up() {
    for replace in REPLACEMENTS {
        let mut bench = Bench::start(Setup::default());
        bench.ok(&SMALL);
        bench.kill_daemon();
        replace(&bench.path("spool/raised"));
        bench.start_daemon_by(limited(&bench));
        let id = bench.start_job("part.layerd");
        wait_until("the question", || reason(&bench.job(id)).contains("the plate was raised from"));
        bench.ok(&["resume", &id.to_string()]);
        bench.wait_for(id, &["completed"]);
        wait_until("the note is gone", || fs::symlink_metadata(bench.path("spool/raised")).is_err());
        assert_eq!(bench.terminate_daemon(), Some(0));
    }
}

#[test]
fn a_lock_that_is_no_file_keeps_the_daemon_from_starting() {
    for replace in REPLACEMENTS {
        let mut bench = Bench::start(Setup::default());
        assert_eq!(bench.terminate_daemon(), Some(0));
        replace(&bench.path("spool/lock"));
        let output = limited(&bench).output().expect("layerd ends");
        let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
        assert!(!output.status.success() && log.contains("spool/lock: it is not a regular file"), "{log}");
    }
}

#[test]
fn the_files_of_a_job_hold_up_neither_its_end_nor_that_of_the_daemon() {
    for (name, replace) in
        ["recipe.toml", "machine.toml", "part.layerd"].into_iter().flat_map(|name| REPLACEMENTS.map(|it| (name, it)))
    {
        let mut bench = interrupted();
        replace(&bench.path("spool/jobs/00000001").join(name));
        bench.start_daemon_by(limited(&bench));
        wait_until("the device", || bench.json(&["device"])["connected"] == true);
        assert_eq!(bench.job(1)["state"], "interrupted");
        bench.layerctl(&["resume", "1"]);
        wait_until("its reason", || reason(&bench.job(1)).contains("it is not a regular file"));
        assert_eq!(bench.wait_for(1, &["interrupted"])["state"], "interrupted");
        bench.ok(&["abort", "1"]);
        bench.wait_for(1, &["aborted"]);
        assert_eq!(bench.terminate_daemon(), Some(0), "{name}");
    }
}

#[test]
fn a_journal_that_is_no_file_ends_by_an_abort() {
    for replace in REPLACEMENTS {
        let mut bench = interrupted();
        replace(&bench.path("spool/jobs/00000001/journal"));
        bench.start_daemon_by(limited(&bench));
        let job = bench.job(1);
        assert!(job["state"] == "interrupted" && reason(&job).contains("it is not a regular file"), "{job}");
        bench.ok(&["abort", "1"]);
        bench.wait_for(1, &["aborted"]);
        assert_eq!(bench.terminate_daemon(), Some(0));
    }
}

#[test]
fn a_configuration_that_is_no_file_is_named() {
    for (name, replace) in
        ["layerd.toml", "machine.toml", "recipe.toml"].into_iter().flat_map(|name| REPLACEMENTS.map(|it| (name, it)))
    {
        let bench = Bench::prepare(Setup::default());
        replace(&bench.path(name));
        let output = limited(&bench).output().expect("layerd ends");
        let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
        assert!(!output.status.success() && log.contains(&format!("{name}: it is not a regular file")), "{log}");
    }
}
