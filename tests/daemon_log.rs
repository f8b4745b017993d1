//! The daemon's log: who ordered what, why a job ended, and how little a flood can make of it.

mod support;

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use rustix::process::{Pid, Resource, Rlimit, getrlimit, prlimit};
use support::{Bench, Setup, wait_until};

const SMALL: [&str; 10] = ["generate", "bcc", "--struts", "300", "--box", "8,8,3", "--seed", "1", "-o", "part.layerd"];

fn log(bench: &Bench) -> String {
    std::fs::read_to_string(bench.path("daemon.log")).expect("a log")
}

#[test]
fn the_log_says_who_ordered_what_and_why_each_job_ended() {
    let mut bench = Bench::start(Setup { exposure_ms: 2_500, time_scale: 10, ..Setup::default() });
    bench.ok(&SMALL);
    let name = "part\u{202e}\n.layerd";
    std::fs::rename(bench.path("part.layerd"), bench.path(name)).expect("renamed");
    let id = bench.start_job(name);
    wait_until("light", || bench.acts().iter().any(|act| act["event"] == "light_on"));
    let aborted = bench.layerctl_command(&["abort"]).stdout(std::process::Stdio::piped()).spawn().expect("layerctl");
    let pid = aborted.id();
    assert!(aborted.wait_with_output().expect("layerctl").status.success());
    bench.wait_for(id, &["aborted"]);
    assert!(!bench.layerctl(&["stop", "7"]).status.success());
    bench.terminate_daemon();
    let (log, uid) = (log(&bench), rustix::process::getuid().as_raw());
    let by = format!("order by uid {uid}");
    for words in [
        format!("pid {pid}: abort: accepted, job {id} is"),
        format!("job {id} ended: aborted after"),
        "layers: aborted by the operator".into(),
        "stop job 7: refused: there is no job `7`".into(),
        "start part\\u{202e} .layerd: accepted".into(),
    ] {
        assert!(log.contains(&by) && log.contains(&words), "`{words}` is not in:\n{log}");
    }
    assert!(!log.contains('\u{202e}'), "{log}");
}

#[test]
fn a_line_that_repeats_is_counted() {
    let mut bench = Bench::start(Setup::default());
    let request = b"POST /v1/jobs/9/pause HTTP/1.1\r\nhost: x\r\ncontent-length: 0\r\n\r\n";
    for _ in 0..500 {
        let mut stream = UnixStream::connect(bench.path("control.sock")).expect("connected");
        stream.write_all(request).expect("sent");
        let _ = stream.read_to_end(&mut Vec::new());
    }
    bench.terminate_daemon();
    let log = log(&bench);
    let refused = log.lines().filter(|line| line.contains("pause job 9: refused") && !line.contains("more times"));
    assert!((1..=12).contains(&refused.count()), "{log}");
    let counted = |line: &str| -> Option<u64> {
        let (count, _) = line.split_once("repeated ")?.1.split_once(" more times")?;
        line.contains("refused").then(|| count.parse().expect("a number"))
    };
    let counted: u64 = log.lines().filter_map(counted).sum();
    assert!((488..=497).contains(&counted), "{counted} counted:\n{log}");
}

#[test]
fn without_file_descriptors_the_log_says_so_once_a_second_and_the_daemon_recovers() {
    let bench = Bench::start(Setup::default());
    let pid = i32::try_from(bench.daemon_pid()).ok().and_then(Pid::from_raw);
    let maximum = getrlimit(Resource::Nofile).maximum;
    let before = prlimit(pid, Resource::Nofile, Rlimit { current: Some(3), maximum }).expect("the daemon's limit");
    let waiting: Vec<_> =
        (0..20).map(|_| UnixStream::connect(bench.path("control.sock")).expect("in the queue")).collect();
    std::thread::sleep(Duration::from_millis(2_500));
    let text = log(&bench);
    let told = text.lines().filter(|line| line.contains("cannot take a connection")).count();
    assert!((1..=3).contains(&told), "{text}");
    prlimit(pid, Resource::Nofile, before).expect("restored");
    drop(waiting);
    wait_until("the daemon's answer", || bench.layerctl(&["status"]).status.success());
}
