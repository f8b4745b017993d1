//! The abort, timed. It stands alone in its file: test files run one after the other, so nothing else takes the processor.

mod support;

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use support::{Bench, Setup, wait_until};

#[test]
fn abort_on_a_saturated_line_turns_the_light_off_within_100_ms() {
    // Layers of tens of kilobytes on a line that carries 11 a second: while one is exposed the next is always under way.
    let setup = Setup { exposure_ms: 20_000, baud: 115_200, time_scale: 1, size_px: [1600, 1200], ..Setup::default() };
    let bench = Bench::start(setup);
    bench.ok(&["generate", "random", "--struts", "12000", "--box", "70,50,3", "--seed", "2", "-o", "part.layerd"]);
    let id = bench.start_job("part.layerd");
    let acts_file = bench.path("device-out/acts.jsonl");
    let logged = |word: &str| std::fs::read_to_string(&acts_file).is_ok_and(|text| text.contains(word));
    wait_until("the first light", || logged("light_on"));
    let sent_bytes = || bench.json(&["status"])["line"]["sent_bytes"].as_u64().expect("sent_bytes");
    let mut rate = 0;
    // On a busy machine the next layer may still be computed.
    wait_until("8000 of 11520 bytes a second on the line", || {
        let before = sent_bytes();
        std::thread::sleep(Duration::from_millis(500));
        rate = (sent_bytes() - before) * 2;
        rate > 8_000
    });

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
    assert!(took < Duration::from_millis(100), "light off after {took:?}");

    bench.wait_for(id, &["aborted"]);
    std::thread::sleep(Duration::from_millis(500));
    let acts = bench.acts();
    let off = acts.iter().position(|act| act["event"] == "light_off").expect("light_off");
    assert!(!acts[off..].iter().any(|act| act["event"] == "light_on" || act["event"] == "exposed"), "{acts:?}");
    assert!(acts[off..].iter().any(|act| act["event"] == "moved"), "the plate lifts clear after an abort: {acts:?}");
    eprintln!("light off {took:?} after the command, line at {rate} bytes a second");
}
