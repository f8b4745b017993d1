//! The simulated device as hosts see it: over a real pseudo-terminal, with faults, and with a log on disk.

mod device_common;

use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use device_common::{capabilities, picture, print::Printer};
use layerd::device::sim::{FaultSpec, SimulateOptions, Statistics, run};
use layerd::layer::export::write_png;
use layerd::link::session::{HostEvent, HostSession, HostSettings};

const BAUD: u32 = 3_000_000;

fn options(directory: &Path, faults: &[&str]) -> SimulateOptions {
    SimulateOptions {
        link: directory.join("printer"),
        directory: Some(directory.join("exposed")),
        baud: Some(BAUD),
        escaped: false,
        faults: faults.iter().map(|spec| spec.parse::<FaultSpec>().expect("a fault")).collect(),
        seed: 11,
        time_scale: 50.0,
        capabilities: capabilities(),
    }
}

/// Runs a device as long as `host` runs.
fn with_device<T: Send>(options: SimulateOptions, host: impl FnOnce() -> T + Send) -> (T, Statistics) {
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let (ready, is_ready) = std::sync::mpsc::channel();
    std::thread::scope(|scope| {
        let device = scope.spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
            runtime.block_on(run(options, move || ready.send(()).expect("someone waits"), async {
                let _ = stopped.await;
            }))
        });
        is_ready.recv_timeout(Duration::from_secs(10)).expect("the device is ready");
        let result = host();
        drop(stop);
        (result, device.join().expect("no panic").expect("no error"))
    })
}

/// Prints over the line at `path` until all layers are exposed.
fn print(path: &Path, mut printer: Printer) -> Printer {
    let started = Instant::now();
    let now_us = || started.elapsed().as_micros() as u64;
    let settings = HostSettings { baud: BAUD, escaped: false };
    let mut session = HostSession::new(0x1001, settings, now_us());
    let mut line = None;
    let mut buffer = [0; 4096];
    while !printer.is_done() {
        assert!(started.elapsed() < Duration::from_secs(60), "the print hangs");
        std::thread::sleep(Duration::from_millis(1));
        let Some(file) = &mut line else {
            line = std::fs::OpenOptions::new()
                .read(true)
                .write(true)
                .custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY)
                .open(path)
                .ok();
            printer.openings += u32::from(line.is_some());
            continue;
        };
        match file.read(&mut buffer) {
            Ok(bytes) => session.receive(&buffer[..bytes], now_us()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => line = None,
        }
        session.handle_timeout(now_us());
        while let Some(event) = session.event() {
            match event {
                HostEvent::Connected { state, .. } => printer.connected(&state),
                HostEvent::Message(message) => printer.message(message),
                HostEvent::UrgentDone { .. } => {}
                HostEvent::Refused(refusal) => panic!("{refusal}"),
                HostEvent::Lost(_) => {
                    printer.lost();
                    session = session.successor(session.session_id() + 1, now_us());
                    line = None;
                }
            }
        }
        printer.work(&mut session);
        while let Some(file) = &mut line
            && let Some(frame) = session.transmit(now_us())
        {
            // Frames are far smaller than what a pseudo-terminal holds; what it does not take is lost, and comes again.
            if file.write_all(&frame).is_err_and(|error| error.kind() != ErrorKind::WouldBlock) {
                line = None;
            }
        }
    }
    printer
}

/// Every layer exposed once, in order, with the very picture.
fn check_exposed(directory: &Path, layers: u32) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(directory.join("exposed/acts.jsonl")).expect("a log");
    let acts: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    let exposed: Vec<_> = acts
        .iter()
        .filter(|act| act["event"] == "exposed")
        .map(|act| act["layer"].as_u64().expect("a layer"))
        .collect();
    assert_eq!(exposed, (0..u64::from(layers)).collect::<Vec<_>>());
    for layer in 0..layers {
        let reference = directory.join("reference.png");
        write_png(&reference, &picture(layer)).expect("written");
        let found = std::fs::read(directory.join(format!("exposed/layer_{layer:06}.png"))).expect("a picture");
        assert_eq!(found, std::fs::read(reference).expect("written"), "layer {layer}");
    }
    acts
}

#[test]
fn a_print_over_a_pseudo_terminal_exposes_every_layer_once() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("printer");
    let (_, statistics) = with_device(options(directory.path(), &[]), || print(&path, Printer::new(12, 500)));
    let acts = check_exposed(directory.path(), 12);
    assert_eq!((statistics.exposed, statistics.cut_short, statistics.refused), (12, 0, 0));
    let first = acts.iter().find(|act| act["event"] == "exposed").expect("an exposure");
    assert_eq!((first["duration_ms"].as_u64(), first["job"].as_u64()), (Some(500), Some(device_common::id(0).job)));
    assert!(std::fs::symlink_metadata(&path).is_err(), "the symlink is gone with the device");
}

#[test]
fn lost_damaged_and_doubled_frames_and_lost_lines_change_nothing() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("printer");
    let faults = ["drop=0.02", "corrupt=0.02", "duplicate=0.02", "disconnect=2", "stall=1x100"];
    let (printer, _) = with_device(options(directory.path(), &faults), || print(&path, Printer::new(25, 2000)));
    check_exposed(directory.path(), 25);
    assert!(printer.openings >= 3, "the line went away twice, but was opened {} times", printer.openings);
}

#[test]
fn a_restarted_device_goes_on_after_the_last_exposed_layer() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("printer");
    let (_, statistics) = with_device(options(directory.path(), &["reset=2"]), || print(&path, Printer::new(16, 2000)));
    check_exposed(directory.path(), 16);
    assert_eq!(statistics.resets, 2);
}

#[test]
fn a_log_that_cannot_be_written_and_a_link_that_is_taken_are_named() {
    let directory = tempfile::tempdir().expect("a directory");
    let mut options = options(directory.path(), &[]);
    std::fs::write(directory.path().join("printer"), "precious").expect("written");
    let refused = |options| {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(run(options, || {}, std::future::pending())).expect_err("refused").to_string()
    };
    let message = refused(options.clone());
    assert!(message.contains("printer") && message.contains("remove it first"), "{message}");
    assert_eq!(std::fs::read(directory.path().join("printer")).expect("kept"), b"precious");
    options.directory = Some(directory.path().join("printer").join("exposed"));
    let message = refused(options);
    assert!(message.contains("cannot write") && message.contains("exposed"), "{message}");
}

#[test]
fn a_picture_that_cannot_be_kept_is_a_fault_the_host_hears_of() {
    let directory = tempfile::tempdir().expect("a directory");
    let exposed = directory.path().join("exposed");
    let (printer, _) = with_device(options(directory.path(), &[]), || {
        std::fs::remove_dir_all(&exposed).expect("removed under the running device");
        print(&directory.path().join("printer"), Printer::new(5, 500))
    });
    let fault = printer.fault.expect("a fault");
    assert!(fault.text.contains("cannot write") && fault.text.len() <= 120, "{fault:?}");
}
