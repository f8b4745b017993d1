//! Signals sent to a daemon that prints, and to a simulated device: those that end it do so in order, no other does any harm.

mod support;

use std::time::{Duration, Instant};

use support::{Bench, Setup, signal, wait_until};

const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];
const LAYERD: &str = env!("CARGO_BIN_EXE_layerd");

/// `clear_height_um` of the bench's machine.
const CLEAR_UM: i64 = 30_000;

/// Signals that would end a process that does not take them.
const HARMLESS: [&str; 6] = ["USR1", "USR2", "PIPE", "ALRM", "PROF", "XFSZ"];

/// A print that is under way, by a daemon that these arguments start. Each layer has light for a quarter of a second.
fn printing(daemon: &[&str]) -> (Bench, u64) {
    let mut bench = Bench::prepare(Setup { exposure_ms: 2_500, time_scale: 10, ..Setup::default() });
    bench.start_device();
    bench.start_daemon_by(bench.daemon_command(daemon));
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("the second layer's light", || lights(&bench) >= 2);
    (bench, id)
}

fn lights(bench: &Bench) -> usize {
    bench.acts().iter().filter(|act| act["event"] == "light_on").count()
}

/// The plate hangs clear, dark, and the job can go on.
fn assert_ended_in_order(bench: &mut Bench, id: u64, what: &str) {
    assert_eq!(bench.wait_daemon(), Some(0), "{what}");
    let acts = bench.acts();
    let last = |event: &str| acts.iter().rposition(|act| act["event"] == event);
    let moved = last("moved").expect("it moved");
    assert_eq!(acts[moved]["position_um"].as_i64(), Some(CLEAR_UM), "{what}: {acts:?}");
    assert!(last("light_on") < Some(moved), "{what}: {acts:?}");
    bench.start_daemon();
    assert_eq!(bench.job(id)["state"], "interrupted", "{what}");
}

/// Whether this process, and so those it starts, has SIGHUP ignored, as under nohup.
fn hangup_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").expect("/proc");
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).expect("SigIgn");
    u64::from_str_radix(mask.trim(), 16).expect("a mask") & 1 != 0
}

#[test]
fn every_signal_that_ends_the_daemon_lifts_the_plate_first() {
    let ending = ["HUP", "INT", "QUIT", "TERM"];
    for (at, name) in ending.into_iter().enumerate().filter(|(_, name)| *name != "HUP" || !hangup_is_ignored()) {
        let (mut bench, id) = printing(&[LAYERD]);
        signal(bench.daemon_pid(), name);
        // More of them while the plate lifts change nothing.
        std::thread::sleep(Duration::from_millis(100));
        for more in [ending[(at + 1) % ending.len()], name, "USR1"] {
            signal(bench.daemon_pid(), more);
        }
        assert_ended_in_order(&mut bench, id, name);
        let log = std::fs::read_to_string(bench.path("daemon.log")).expect("a log");
        assert!(log.contains(&format!("SIG{name}: ending")), "{log}");
    }
}

#[test]
fn no_other_signal_harms_a_print() {
    let (bench, id) = printing(&[LAYERD]);
    for name in HARMLESS {
        signal(bench.daemon_pid(), name);
        std::thread::sleep(Duration::from_millis(50));
    }
    assert_eq!(bench.wait_for(id, &["completed", "interrupted", "failed"])["state"], "completed");
}

#[test]
fn under_nohup_a_hangup_does_not_end_the_print() {
    let (mut bench, id) = printing(&["sh", "-c", "trap '' HUP; exec \"$@\"", "sh", LAYERD]);
    signal(bench.daemon_pid(), "HUP");
    let before = lights(&bench);
    wait_until("further layers", || lights(&bench) >= before + 2);
    signal(bench.daemon_pid(), "TERM");
    assert_ended_in_order(&mut bench, id, "TERM");
}

#[test]
fn a_simulated_device_ends_in_order_and_only_when_it_is_to() {
    for name in ["HUP", "INT", "QUIT", "TERM"].into_iter().filter(|name| *name != "HUP" || !hangup_is_ignored()) {
        let mut bench = Bench::prepare(Setup::default());
        bench.start_device();
        for harmless in HARMLESS {
            signal(bench.device_pid(), harmless);
        }
        std::thread::sleep(Duration::from_millis(50));
        assert!(bench.path("device").exists(), "the device goes on");
        signal(bench.device_pid(), name);
        assert_eq!(bench.wait_device(), Some(0), "{name}");
        assert!(std::fs::symlink_metadata(bench.path("device")).is_err(), "{name}: its link goes with it");
    }
}

#[test]
fn a_live_link_is_refused_to_a_second_device_and_a_stale_one_is_replaced() {
    let mut bench = Bench::prepare(Setup::default());
    bench.start_device();
    let target = std::fs::read_link(bench.path("device")).expect("a link");
    // By another name of the same directory.
    for link in ["device", "./device", "../../../../../../../..{}/device"] {
        let link = link.replace("{}", &bench.dir.path().display().to_string());
        let began = Instant::now();
        let second = bench.layerctl(&["simulate", "dlp", "--link", &link]);
        let told = String::from_utf8_lossy(&second.stderr).into_owned();
        assert_eq!(second.status.code(), Some(1), "{told}");
        assert!(told.contains("another simulated device serves") && told.contains("--link"), "{told}");
        assert!(began.elapsed() < Duration::from_secs(20), "it does not run");
    }
    assert_eq!(std::fs::read_link(bench.path("device")).expect("a link"), target, "the first one's link stays");
    bench.kill_device_leaving_its_link();
    bench.start_device();
    wait_until("a new target", || std::fs::read_link(bench.path("device")).is_ok_and(|new| new.exists()));
}

/// A terminal or a pipe that is gone, or that takes nothing, keeps no print from ending.
#[test]
fn a_lost_stderr_does_not_harm_a_print() {
    for is_closed in [true, false] {
        let mut bench = Bench::prepare(Setup { exposure_ms: 2_500, time_scale: 10, ..Setup::default() });
        bench.start_device();
        let (reader, writer) = std::io::pipe().expect("a pipe");
        let mut command = bench.daemon_command(&[LAYERD]);
        if is_closed {
            drop(reader);
        } else {
            fill(&writer);
            // Held open and never read, as by a terminal that stands still.
            std::mem::forget(reader);
        }
        command.stderr(writer);
        bench.start_daemon_by(command);
        bench.ok(&SMALL);
        let id = bench.start_job("part.layerd");
        assert_eq!(bench.wait_for(id, &["completed", "interrupted", "failed"])["state"], "completed");
        assert_eq!(bench.terminate_daemon(), Some(0), "closed: {is_closed}");
    }
}

/// Writes until a pipe takes no more.
fn fill(writer: &std::io::PipeWriter) {
    use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
    let flags = fcntl_getfl(writer).expect("flags");
    fcntl_setfl(writer, flags | OFlags::NONBLOCK).expect("flags");
    while rustix::io::write(writer, &[b'.'; 1024]).is_ok() {}
    while rustix::io::write(writer, b".").is_ok() {}
    fcntl_setfl(writer, flags).expect("flags");
}
