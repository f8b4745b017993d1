//! Devices that are not the configured one: the operator is told what is configured, what was found and what to do.

mod support;

use std::io::{Read, Write};
use std::os::unix::fs::symlink;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use layerd::device::sim::{SimulateOptions, run};
use layerd::link::message::{Capabilities, DeviceKind, Encoding};
use layerd::link::wire::{FrameDecoder, FrameKind, HelloRefused, encode_frame};
use serialport::{SerialPort, TTYPort};
use support::{Bench, Setup, wait_until};

const SMALL: [&str; 8] = ["generate", "bcc", "--struts", "100", "--box", "8,8,1", "-o", "part.layerd"];

/// A device of the bench's size that is a laser machine by its own word.
fn laser() -> Capabilities {
    Capabilities {
        kind: DeviceKind::Slm,
        name: "laser".into(),
        width_px: 400,
        height_px: 300,
        pixel_nm: [50_000; 2],
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::RawBit, Encoding::Group4],
        max_exposure_ms: 10_000,
        max_position_um: 100_000,
    }
}

#[test]
fn a_device_of_another_kind_is_refused_by_name_and_never_commanded() {
    let mut bench = Bench::prepare(Setup::default());
    bench.ok(&SMALL);
    let options = SimulateOptions {
        link: bench.path("device"),
        directory: Some(bench.path("device-out")),
        baud: Some(3_000_000),
        escaped: false,
        faults: Vec::new(),
        seed: 1,
        time_scale: 50.0,
        capabilities: laser(),
    };
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let device = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(run(options, || (), async { stopped.await.unwrap_or_default() }))
    });
    wait_until("the device's line", || bench.path("device").exists());
    bench.start_daemon();
    let id = bench.start_job("part.layerd");
    let job = bench.wait_for(id, &["failed", "completed"]);
    assert_eq!(job["state"], "failed", "{job}");
    let reason = job["reason"].as_str().expect("a reason");
    assert!(reason.contains("`bench`") && reason.contains("`laser`") && reason.contains("slm"), "{reason}");
    assert!(reason.contains("connect the right device"), "{reason}");
    drop(stop);
    device.join().expect("no panic").expect("the device runs");
    assert!(bench.acts().iter().all(|act| act["event"] == "hello"), "{:?}", bench.acts());
}

#[test]
fn a_device_of_another_protocol_version_is_named_in_the_status() {
    let mut bench = Bench::prepare(Setup::default());
    let (mut master, slave) = TTYPort::pair().expect("a pseudo-terminal");
    symlink(slave.name().expect("its name"), bench.path("device")).expect("link");
    master.set_timeout(Duration::from_millis(20)).expect("timeout");
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let device = std::thread::spawn(move || {
        let (mut decoder, mut buffer) = (FrameDecoder::new(1024), [0; 1024]);
        while !stopped.load(Ordering::Relaxed) {
            // A timeout only means that the host is silent.
            let count = master.read(&mut buffer).unwrap_or(0);
            let mut input = &buffer[..count];
            while let Some(frame) = decoder.next_frame(&mut input) {
                let Ok(hello) = frame.map(|decoded| decoded.frame) else { continue };
                if hello.kind == FrameKind::Hello {
                    let refused = HelloRefused::Version { lowest: 2, highest: 3 }.encode();
                    let answer = encode_frame(FrameKind::HelloRefused, hello.session_id, 0, &refused);
                    master.write_all(&answer).expect("written");
                }
            }
        }
    });
    bench.start_daemon();
    let reason = || bench.json(&["status"])["link"]["reason"].as_str().unwrap_or_default().to_owned();
    wait_until("the refusal", || reason().contains("the device speaks versions 2 to 3 of the protocol"));
    assert!(reason().contains("this host speaks 1"), "{}", reason());
    stop.store(true, Ordering::Relaxed);
    device.join().expect("no panic");
    drop(slave);
}
