//! Disks that hang, and file systems that set no room aside: the daemon goes on answering, a plate is lifted, and it ends.

mod support;

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use serde_json::Value;
use support::{Bench, Setup, skipped, wait_until};

const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];

/// `clear_height_um` of the bench's machine.
const CLEAR_UM: i64 = 30_000;

/// What stands between the daemon and its disk (LD_PRELOAD). While the file `$TEST_DISK_HANGS` exists, flushes hang and so does
/// the opening of files below `incoming`; each call that hangs adds a byte to `$TEST_DISK_HANGS.calls`. With `$TEST_NO_FALLOCATE`
/// the kernel answers fallocate(2) as it does for a file system that cannot set room aside.
const DISK: &str = r#"
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

static void disk(void) {
    const char *hangs = getenv("TEST_DISK_HANGS");
    if (!hangs || access(hangs, F_OK) != 0) return;
    char calls[4096];
    snprintf(calls, sizeof calls, "%s.calls", hangs);
    int fd = syscall(SYS_openat, AT_FDCWD, calls, O_WRONLY | O_CREAT | O_APPEND, 0644);
    if (fd < 0 || write(fd, "x", 1) != 1) abort();
    close(fd);
    while (access(hangs, F_OK) == 0) usleep(10000);
}

int fdatasync(int fd) { disk(); return syscall(SYS_fdatasync, fd); }
int fsync(int fd) { disk(); return syscall(SYS_fsync, fd); }

int open64(const char *path, int flags, ...) {
    va_list list;
    va_start(list, flags);
    int mode = va_arg(list, int);
    va_end(list);
    if (strstr(path, "incoming/")) disk();
    return syscall(SYS_openat, AT_FDCWD, path, flags, mode);
}
int open(const char *path, int flags, ...) {
    va_list list;
    va_start(list, flags);
    int mode = va_arg(list, int);
    va_end(list);
    return open64(path, flags, mode);
}

__attribute__((constructor)) static void no_room(void) {
    if (!getenv("TEST_NO_FALLOCATE")) return;
    struct sock_filter filter[] = {
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_fallocate, 0, 1),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | EOPNOTSUPP),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
    };
    struct sock_fprog program = { sizeof filter / sizeof *filter, filter };
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) || prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program)) abort();
}
"#;

/// A bench whose daemon has such a disk; `None` without a C compiler.
fn bench(setup: Setup, variables: &[&str]) -> Option<Bench> {
    let mut bench = Bench::prepare(setup);
    fs::write(bench.path("disk.c"), DISK).expect("written");
    let library = bench.path("disk.so");
    let compiled = Command::new("cc")
        .current_dir(bench.dir.path())
        .args(["-shared", "-fPIC", "-O1", "disk.c", "-o"])
        .arg(&library)
        .output();
    let Ok(compiled) = compiled else {
        skipped("there is no C compiler `cc`");
        return None;
    };
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    bench.start_device();
    start_daemon(&mut bench, variables);
    bench.ok(&SMALL);
    Some(bench)
}

/// Starts the daemon on that disk.
fn start_daemon(bench: &mut Bench, variables: &[&str]) {
    let mut command = bench.daemon_command(&[env!("CARGO_BIN_EXE_layerd")]);
    command.env("LD_PRELOAD", bench.path("disk.so")).env("TEST_DISK_HANGS", hangs(bench));
    variables.iter().for_each(|name| {
        command.env(name, "1");
    });
    bench.start_daemon_by(command);
}

fn hangs(bench: &Bench) -> PathBuf {
    bench.path("hangs")
}

fn hang(bench: &Bench) {
    fs::write(hangs(bench), "").expect("written");
}

fn answer_again(bench: &Bench) {
    fs::remove_file(hangs(bench)).expect("removed");
}

/// Waits until so many calls have hung.
fn wait_until_hanging(bench: &Bench, calls: u64) {
    let made = || fs::metadata(bench.path("hangs.calls")).map_or(0, |file| file.len());
    wait_until("calls to the disk", || made() >= calls);
}

fn plate_um(acts: &[Value]) -> Option<i64> {
    acts.iter().rev().find(|act| act["event"] == "moved").and_then(|act| act["position_um"].as_i64())
}

#[test]
fn an_upload_that_hangs_keeps_nobody_from_asking_or_from_ending_the_daemon() {
    let Some(mut bench) = bench(Setup::default(), &[]) else { return };
    hang(&bench);
    let start =
        || bench.layerctl_command(&["start", "part.layerd"]).stdout(Stdio::null()).spawn().expect("layerctl starts");
    let mut first = start();
    wait_until_hanging(&bench, 1);
    for command in ["status", "jobs", "device"] {
        bench.ok(&[command]);
    }
    // One who asks and goes, again and again, makes no number of threads that hang.
    first.kill().expect("killed");
    first.wait().expect("waited");
    let mut second = start();
    wait_until_hanging(&bench, 2);
    let refused = bench.layerctl(&["start", "part.layerd"]);
    let text = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && text.contains("2 uploads are under way"), "{text}");
    answer_again(&bench);
    assert!(second.wait().expect("waited").success());
    bench.wait_for(1, &["completed"]);
    wait_until("an empty incoming", || fs::read_dir(bench.path("spool/incoming")).expect("incoming").count() == 0);

    hang(&bench);
    let mut third = bench.layerctl_command(&["start", "part.layerd"]).spawn().expect("layerctl starts");
    wait_until_hanging(&bench, 3);
    assert_eq!(bench.terminate_daemon(), Some(0));
    assert!(!third.wait().expect("waited").success());
}

#[test]
fn an_abort_lifts_the_plate_though_the_disk_hangs_and_is_written_when_it_answers() {
    let Some(mut bench) = bench(Setup { exposure_ms: 24_000, time_scale: 4, ..Setup::default() }, &[]) else { return };
    let id = bench.start_job("part.layerd");
    wait_until("light", || bench.acts().iter().any(|act| act["event"] == "light_on"));
    hang(&bench);
    let answer = bench.json(&["abort"]);
    let warning = answer["warning"].as_str().unwrap_or_default();
    assert!(warning.contains("the disk has not taken its record yet"), "{answer}");
    wait_until("the lift", || plate_um(&bench.acts()) == Some(CLEAR_UM));
    assert!(bench.acts().iter().any(|act| act["event"] == "light_off"), "{:?}", bench.acts());
    let waits = |job: &Value| job["reason"].as_str().is_some_and(|reason| reason.contains("waiting for the disk"));
    wait_until("the reason", || waits(&bench.job(id)));
    assert_eq!(bench.job(id)["state"], "aborting", "it is not on disk: {}", bench.job(id));
    let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
    assert!(log.contains("the disk has not taken the journal's last record"), "{log}");
    answer_again(&bench);
    let job = bench.wait_for(id, &["aborted", "failed", "interrupted"]);
    assert_eq!(job["state"], "aborted", "{job}");
    // All of it is on disk: the next daemon knows the end, and that the plate was lifted.
    bench.kill_daemon();
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "aborted");
    let next = bench.start_job("part.layerd");
    let reason = bench.job(next)["reason"].clone();
    assert!(!reason.as_str().is_some_and(|reason| reason.contains("empty plate")), "{reason}");
}

#[test]
fn a_plate_is_raised_though_the_disk_hangs_and_the_note_is_written_when_it_answers() {
    let Some(mut bench) = bench(Setup { exposure_ms: 2000, time_scale: 20, ..Setup::default() }, &[]) else { return };
    bench.start_and_kill();
    start_daemon(&mut bench, &[]);
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    hang(&bench);
    let answer = bench.json(&["raise"]);
    let warning = answer["warning"].as_str().unwrap_or_default();
    assert!(warning.contains("the disk has not taken the note") && answer["to_um"] == CLEAR_UM, "{answer}");
    wait_until("the lift", || plate_um(&bench.acts()) == Some(CLEAR_UM));
    assert!(!bench.path("spool/raised").exists());
    answer_again(&bench);
    wait_until("the note", || bench.path("spool/raised").exists());
}

/// An abort ends a lift that still waits for the disk.
#[test]
fn an_abort_takes_back_a_plate_that_is_not_raised_yet() {
    let Some(mut bench) = bench(Setup { exposure_ms: 2000, time_scale: 20, ..Setup::default() }, &[]) else { return };
    bench.start_and_kill();
    fs::remove_dir_all(bench.path("spool")).expect("the spool");
    start_daemon(&mut bench, &[]);
    wait_until("the device", || bench.json(&["device"])["connected"] == true);
    let before = plate_um(&bench.acts());
    hang(&bench);
    let raise = bench.layerctl_command(&["raise"]).stderr(Stdio::piped()).spawn().expect("layerctl starts");
    wait_until_hanging(&bench, 1);
    assert_eq!(bench.layerctl(&["abort"]).status.code(), Some(1), "there is no job");
    let raised = raise.wait_with_output().expect("waited");
    let text = String::from_utf8_lossy(&raised.stderr).into_owned();
    assert!(!raised.status.success() && text.contains("was not raised: an abort came first"), "{text}");
    answer_again(&bench);
    wait_until("the note", || bench.path("spool/raised").exists());
    wait_until("the device again", || bench.json(&["device"])["connected"] == true);
    assert_eq!(plate_um(&bench.acts()), before, "it did not move");
}

#[test]
fn a_file_system_that_sets_no_room_aside_is_told_and_printed_from() {
    let Some(mut bench) = bench(Setup::default(), &["TEST_NO_FALLOCATE"]) else { return };
    let id = bench.start_job("part.layerd");
    bench.wait_for(id, &["completed"]);
    let log = fs::read_to_string(bench.path("daemon.log")).expect("log");
    assert_eq!(log.matches("sets no room aside (fallocate)").count(), 1, "{log}");
    bench.kill_daemon();
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "completed");
}
