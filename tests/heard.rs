//! A device that is heard but does not hear: the status names cable, `baud` and `flow_control`, as the log does.

mod support;

use std::io::{Read, Write};
use std::os::unix::fs::symlink;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use layerd::link::message::DeviceState;
use layerd_wire::{Ack, FrameDecoder, FrameKind, Welcome, encode_frame};
use serialport::{SerialPort, TTYPort};
use support::{Bench, Setup, bench_device, wait_until};

/// Time between two signs of life.
const LIFE_INTERVAL: Duration = Duration::from_millis(200);

/// Welcomes one session and acknowledges none of its data, until `stop` is set.
fn talk_without_listening(mut line: TTYPort, stop: &AtomicBool) {
    line.set_timeout(Duration::from_millis(5)).expect("a timeout");
    let mut decoder = FrameDecoder::new(1024);
    let (mut session, mut told_at) = (None, Instant::now());
    let mut buffer = [0; 4096];
    while !stop.load(Ordering::Relaxed) {
        // A timeout only means that the host is silent.
        let count = line.read(&mut buffer).unwrap_or(0);
        let mut input = &buffer[..count];
        while let Some(decoded) = decoder.next_frame(&mut input) {
            let Some(frame) = decoded.ok().map(|decoded| decoded.frame) else { continue };
            if frame.kind == FrameKind::Hello && session.is_none() {
                session = Some(frame.session_id);
                let welcome = Welcome { version: 1, capabilities: bench_device(), state: DeviceState::default() };
                let _ = line.write_all(&encode_frame(FrameKind::Welcome, frame.session_id, 0, &welcome.encode()));
            }
        }
        if let Some(id) = session
            && told_at.elapsed() > LIFE_INTERVAL
        {
            let ack = Ack { next_sequence: 0, gap: false, last_heard: u32::MAX, free_bytes: 4096 };
            let _ = line.write_all(&encode_frame(FrameKind::Ack, id, 0, &ack.encode()));
            told_at = Instant::now();
        }
    }
}

#[test]
fn a_device_that_does_not_hear_is_not_said_to_be_switched_off() {
    let mut bench = Bench::prepare(Setup { time_scale: 1, ..Setup::default() });
    let (master, slave) = TTYPort::pair().expect("a pseudo-terminal");
    symlink(slave.name().expect("its name"), bench.path("device")).expect("link");
    let stop = Arc::new(AtomicBool::new(false));
    let device = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || talk_without_listening(master, &stop)
    });
    bench.start_daemon();
    let status = || bench.json(&["status"]);
    let reason = || status()["link"]["reason"].as_str().unwrap_or_default().to_owned();
    wait_until("the device", || status()["link"]["state"] == "connected");
    wait_until("the loss", || status()["link"]["state"] == "lost");
    // The next session has no answer at all.
    wait_until("the next try", || reason().contains("no answer either"));
    let told = reason();
    for words in ["the device is heard", "acknowledged nothing", "check the cable", "`baud`", "`flow_control`"] {
        assert!(told.contains(words), "`{words}` is not in {told}");
    }
    assert!(!told.contains("switched on") && bench.ok(&["status"]).contains("check the cable"), "{told}");
    stop.store(true, Ordering::Relaxed);
    device.join().expect("no panic");
    drop(slave);
}
