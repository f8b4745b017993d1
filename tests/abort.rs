//! The abort, timed. It stands alone in its file: test files run one after the other, so nothing else takes the processor.

mod lag;
mod support;

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use lag::{LARGEST_LAG, Lag};
use support::{Bench, Setup, skipped, wait_until};

/// Attempts to find a moment at which the machine itself does not stand still, as one does whose host has no time for it.
const ATTEMPTS: usize = 4;

/// So many on a machine that did not stand still are no chance: one may come of other work on all its processors.
const MISSES: usize = 2;

/// Of the 11,520 that the line carries.
const SATURATED_BYTES_PER_S: f64 = 8_000.0;

#[test]
fn abort_on_a_saturated_line_turns_the_light_off_within_100_ms() {
    let (mut found, mut missed) = (Vec::new(), Vec::new());
    for _ in 0..ATTEMPTS {
        let lag = Lag::begin();
        let took = abort_once();
        let lag = lag.end();
        match took {
            Ok(took) if took < Duration::from_millis(100) => return,
            _ if lag <= LARGEST_LAG => missed.push(took),
            _ => found.push((took, lag)),
        }
        assert!(missed.len() < MISSES, "light off, or bytes a second on a line not saturated: {missed:?}");
    }
    skipped(&format!("this machine stands still too often to measure (light off or bytes a second, lag): {found:?}"));
}

/// Aborts a print while a layer is exposed and the next one is on the line; how long it took to turn the light off, or the
/// bytes a second on a line that was not saturated while there was light.
fn abort_once() -> Result<Duration, f64> {
    // Layers of tens of kilobytes, the first ones too, on a line that carries 11 a second: while one is exposed the next is
    // under way.
    let setup = Setup { exposure_ms: 20_000, baud: 115_200, time_scale: 1, size_px: [1600, 1200], ..Setup::default() };
    let bench = Bench::start(setup);
    bench.ok(&["generate", "bcc", "--struts", "60000", "--box", "70,50,3", "-o", "part.layerd"]);
    let id = bench.start_job("part.layerd");
    let acts_file = bench.path("device-out/acts.jsonl");
    let logged = |word: &str| std::fs::read_to_string(&acts_file).is_ok_and(|text| text.contains(word));
    wait_until("the first light", || logged("light_on"));
    let sent_bytes = || (Instant::now(), bench.json(&["status"])["line"]["sent_bytes"].as_u64().expect("sent_bytes"));
    let rate = loop {
        let (before, bytes_before) = sent_bytes();
        std::thread::sleep(Duration::from_millis(500));
        let (after, bytes_after) = sent_bytes();
        let rate = (bytes_after - bytes_before) as f64 / (after - before).as_secs_f64();
        if logged("light_off") {
            return Err(rate);
        }
        if rate >= SATURATED_BYTES_PER_S {
            break rate;
        }
    };

    let mut socket = UnixStream::connect(bench.path("control.sock")).expect("control socket");
    let commanded = Instant::now();
    socket.write_all(b"POST /v1/abort HTTP/1.1\r\nHost: layerd\r\nConnection: close\r\n\r\n").expect("sent");
    while !logged("light_off") {
        assert!(commanded.elapsed() < Duration::from_secs(10), "the light stays on");
        std::thread::sleep(Duration::from_millis(1));
    }
    let took = commanded.elapsed();
    let mut answer = String::new();
    socket.read_to_string(&mut answer).expect("answer");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");

    bench.wait_for(id, &["aborted"]);
    std::thread::sleep(Duration::from_millis(500));
    let acts = bench.acts();
    // What must never be is checked each time.
    let off = acts.iter().position(|act| act["event"] == "light_off").expect("light_off");
    assert!(!acts[off..].iter().any(|act| act["event"] == "light_on" || act["event"] == "exposed"), "{acts:?}");
    assert!(acts[off..].iter().any(|act| act["event"] == "moved"), "the plate lifts clear after an abort: {acts:?}");
    eprintln!("light off {took:?} after the command, line at {rate:.0} bytes a second");
    Ok(took)
}
