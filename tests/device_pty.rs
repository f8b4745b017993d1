//! The simulated device as hosts see it: over a real pseudo-terminal, with faults, and with a log on disk.

mod device_common;

use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use device_common::powder::{self, Powder, Sent};
use device_common::powder_print::PowderPrinter;
use device_common::{Host, capabilities, picture, print::Printer};
use layerd::device::sim::{FaultSpec, SimulateOptions, Statistics, run};
use layerd::layer::LaserParameters;
use layerd::layer::export::write_png;
use layerd::link::message::Encoding;
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
        melt: None,
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
fn print<H: Host>(path: &Path, mut printer: H) -> H {
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
            if line.is_some() {
                printer.opened();
            }
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

/// Layers of a laser machine, some of them larger than its buffer.
fn powder_layers() -> Vec<Sent> {
    // Slow enough that an act that passes over most of a layer has time left to mark.
    let laser = LaserParameters { mark_speed_um_s: 125_000, ..powder::LASER };
    let layer = |rings, encoding| powder::sent_with(&powder::rings(rings), encoding, laser);
    vec![
        layer(40, Encoding::Vectors),
        layer(800, Encoding::VectorsCoded),
        layer(800, Encoding::Vectors),
        layer(100, Encoding::VectorsCoded),
        layer(500, Encoding::Vectors),
    ]
}

/// Prints on a simulated laser machine with these faults. Every vector was marked, and none twice unless it was interrupted; the pictures
/// are those of layers without a disturbance.
fn print_powder(faults: &[&str], most_ms: u32) -> (PowderPrinter, Statistics, Vec<serde_json::Value>) {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("printer");
    let melt = Some(powder::melt_settings());
    let capabilities = powder::capabilities();
    let options = SimulateOptions { capabilities, melt, time_scale: 5.0, ..options(directory.path(), faults) };
    let printer = PowderPrinter::new(powder_layers(), powder::BUFFER_BYTES, most_ms);
    let (printer, statistics) = with_device(options, || print(&path, printer));
    let text = std::fs::read_to_string(directory.path().join("exposed/acts.jsonl")).expect("a log");
    let acts: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    for (layer, rings) in [40, 800, 800, 100, 500].into_iter().enumerate() {
        let mut next = 0;
        for act in acts.iter().filter(|act| act["layer"].as_u64() == Some(layer as u64)) {
            let end = match act["event"].as_str() {
                Some("marked") => act["vectors"].as_u64(),
                Some("laser_off") => act["next_vector"].as_u64(),
                _ => None,
            };
            if let Some(end) = end {
                assert_eq!(act["from_vector"].as_u64(), Some(next), "layer {layer}");
                next = end;
            }
        }
        assert_eq!(next, 4 * rings, "layer {layer}");
        let mut undisturbed = Powder::ready();
        undisturbed.mark_whole(&powder::sent(&powder::rings(rings as i32)));
        let reference = directory.path().join("reference.png");
        write_png(&reference, &undisturbed.pictures[0].1).expect("written");
        let found = std::fs::read(directory.path().join(format!("exposed/layer_{layer:06}.png"))).expect("a picture");
        assert_eq!(found, std::fs::read(reference).expect("written"), "layer {layer}");
    }
    assert_eq!((statistics.exposed, statistics.vectors), (5, 4 * 2240));
    (printer, statistics, acts)
}

#[test]
fn a_laser_machine_marks_layers_larger_than_its_buffer() {
    let (_, statistics, acts) = print_powder(&[], 60_000);
    assert_eq!((statistics.cut_short, statistics.refused, statistics.recoats), (0, 0, 5));
    let laser_ms: u64 =
        acts.iter().filter(|act| act["event"] == "marked").filter_map(|act| act["duration_ms"].as_u64()).sum();
    // Each of 2240 rings takes 6460 µs of light.
    assert!((14_468..=14_473).contains(&laser_ms), "{laser_ms}");
}

#[test]
fn a_disturbed_laser_machine_marks_every_vector_once() {
    let faults = ["drop=0.02", "corrupt=0.02", "duplicate=0.02", "disconnect=2", "reset=2"];
    let (printer, statistics, _) = print_powder(&faults, 1000);
    assert_eq!(statistics.resets, 2);
    assert!(printer.openings >= 3 && statistics.cut_short > 0, "{statistics:?}");
}

#[test]
fn open_interlocks_are_dark_at_once_and_the_print_goes_on_when_they_are_closed() {
    let (printer, statistics, acts) = print_powder(&["oxygen=1", "door=1", "power=1"], 1000);
    let mut faults = printer.faults;
    faults.sort();
    assert_eq!(faults, ["oxygen at 1.2 %: above 0.5 %", "the door of the chamber is open", "the laser has no power"]);
    assert!(statistics.cut_short >= 3, "{statistics:?}");
    let cut = acts.iter().filter(|act| act["event"] == "laser_off" && act["reason"] == "fault").count();
    assert_eq!(cut, 3, "each of them while it marked");
}
