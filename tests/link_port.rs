//! The driver on a pseudo-terminal with a device session at its other end.

use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use layerd::link::driver::{LinkEvent, link};
use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, HostMessage, MachineCapabilities, Reply, Request, Urgent,
    VatCapabilities, Vats,
};
use layerd::link::session::HostEvent;
use layerd::link::transport::{OpenError, SerialLine};
use layerd::link::{FlowControl, LinkSettings, Protocol, SystemPorts};
use layerd_wire::session::{DeviceEvent, DeviceSession, DeviceSettings};
use rustix::fs::inotify;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{ControlModes, InputModes, LocalModes, OptionalActions, tcgetattr, tcsetattr};
use tokio::sync::mpsc::Receiver;
use tokio::time::timeout;

/// A pseudo-terminal's device side, and the path of its host side.
fn terminal() -> (OwnedFd, PathBuf) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
    grantpt(&master).expect("granted");
    unlockpt(&master).expect("unlocked");
    let name = ptsname(&master, Vec::new()).expect("a name");
    (master, PathBuf::from(name.to_str().expect("ASCII")))
}

fn config(path: &Path) -> LinkSettings {
    LinkSettings { path: path.into(), baud: 3_000_000, flow_control: FlowControl::None, protocol: Protocol::Layerd }
}

/// Answers every request with `Done` and every urgent frame, until the time is over or `requests` were answered.
fn run_device(master: &OwnedFd, requests: usize) -> Vec<DeviceEvent> {
    let capabilities = Capabilities {
        name: "test".into(),
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 1024,
        encodings: Vec::new(),
        max_exposure_ms: 1,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: 16,
            height_px: 16,
            pixel_nm: [50_000; 2],
            max_position_um: 1,
            vats: Vats::ONE,
        }),
    };
    rustix::io::ioctl_fionbio(master, true).expect("non-blocking");
    let start = Instant::now();
    let now_us = || u64::try_from(start.elapsed().as_micros()).expect("short");
    let mut device = DeviceSession::new(capabilities, DeviceSettings { baud: 3_000_000, escaped: false }, 0);
    let (mut seen, mut answered, mut buffer) = (Vec::new(), 0, [0_u8; 4096]);
    // A little longer than the last answer, so that it goes out.
    let mut end = start + Duration::from_secs(10);
    while Instant::now() < end {
        device.handle_timeout(now_us());
        if let Ok(count) = rustix::io::read(master, &mut buffer) {
            device.receive(&buffer[..count], now_us());
        }
        while let Some(event) = device.event() {
            match &event {
                DeviceEvent::Hello { .. } => device.welcome(&DeviceState::default(), now_us()),
                DeviceEvent::Urgent { number, .. } => device.urgent_done(*number, false),
                DeviceEvent::Message(HostMessage::Request { number, .. }) => {
                    device.send(&DeviceMessage::Reply { number: *number, reply: Reply::Done }).expect("room");
                    answered += 1;
                    if answered == requests {
                        end = Instant::now() + Duration::from_millis(100);
                    }
                }
                _ => {}
            }
            seen.push(event);
        }
        while let Some(frame) = device.transmit(now_us()) {
            rustix::io::write(master, &frame).expect("the terminal takes a frame");
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    seen
}

/// The next event that `pick` wants, within five seconds.
async fn wait_for<T>(events: &mut Receiver<LinkEvent>, mut pick: impl FnMut(&LinkEvent) -> Option<T>) -> T {
    let search = async {
        loop {
            let event = events.recv().await.expect("the driver runs");
            if let Some(found) = pick(&event) {
                return found;
            }
        }
    };
    timeout(Duration::from_secs(5), search).await.expect("within five seconds")
}

fn connected(event: &LinkEvent) -> Option<u32> {
    match event {
        LinkEvent::Session(HostEvent::Connected { session_id, .. }) => Some(*session_id),
        _ => None,
    }
}

#[tokio::test]
async fn a_line_carries_messages_and_comes_back_after_the_device_vanished() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("port");
    let (handle, mut events, driver) = link(config(&path), None, Arc::new(SystemPorts));
    let task = tokio::spawn(driver.run());
    // Nothing there yet.
    wait_for(&mut events, |event| matches!(event, LinkEvent::NotOpen(OpenError::Missing(_))).then_some(())).await;
    let mut sessions = Vec::new();
    for _ in 0..2 {
        // The link points at another terminal each time, as after a restart of the device.
        let (master, name) = terminal();
        let _ = std::fs::remove_file(&path);
        std::os::unix::fs::symlink(&name, &path).expect("a link");
        let device = std::thread::spawn(move || run_device(&master, 1));
        let session_id = wait_for(&mut events, connected).await;
        for index in 0..100_u8 {
            handle.room().await;
            handle.try_send(session_id, HostMessage::LayerData(vec![index; 700])).expect("room");
        }
        handle.urgent(Urgent::LightOff).expect("room");
        let request = HostMessage::Request { number: 1, request: Request::State };
        handle.room().await;
        handle.try_send(session_id, request).expect("room");
        let (mut urgent, mut reply) = (false, false);
        while !(urgent && reply) {
            let is_urgent = wait_for(&mut events, |event| match event {
                LinkEvent::Session(HostEvent::UrgentDone { light_on: false, .. }) => Some(true),
                LinkEvent::Session(HostEvent::Message(DeviceMessage::Reply { number: 1, reply: Reply::Done })) => {
                    Some(false)
                }
                _ => None,
            })
            .await;
            urgent |= is_urgent;
            reply |= !is_urgent;
        }
        sessions.push(session_id);
        // The device's thread ends and closes the terminal.
        wait_for(&mut events, |event| matches!(event, LinkEvent::PortFailed(_)).then_some(())).await;
        let seen = device.join().expect("no panic");
        let pieces = seen.iter().filter_map(|event| match event {
            DeviceEvent::Message(HostMessage::LayerData(piece)) => Some(piece[0]),
            _ => None,
        });
        assert!(pieces.eq(0..100), "every piece once, in order");
    }
    assert_ne!(sessions[0], sessions[1]);
    drop(handle);
    timeout(Duration::from_secs(6), task).await.expect("the driver ends with its handles").expect("no panic");
}

/// A link such as those in /dev/serial/by-id that leads to another adapter now, while the old port is open and silent.
#[tokio::test]
async fn a_path_that_leads_elsewhere_is_followed_once_its_port_is_silent() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("port");
    let (_silent, silent_name) = terminal();
    std::os::unix::fs::symlink(&silent_name, &path).expect("a link");
    let (handle, mut events, driver) = link(config(&path), None, Arc::new(SystemPorts));
    let task = tokio::spawn(driver.run());
    let lost = |event: &LinkEvent| matches!(event, LinkEvent::Session(HostEvent::Lost(_))).then_some(());
    wait_for(&mut events, lost).await;
    let (master, name) = terminal();
    std::fs::remove_file(&path).expect("the old link");
    std::os::unix::fs::symlink(&name, &path).expect("a new link");
    let device = std::thread::spawn(move || run_device(&master, 1));
    let session_id = wait_for(&mut events, connected).await;
    handle.room().await;
    handle.try_send(session_id, HostMessage::Request { number: 1, request: Request::State }).expect("room");
    device.join().expect("it is asked at the new port");
    drop(handle);
    timeout(Duration::from_secs(6), task).await.expect("the driver ends with its handles").expect("no panic");
}

#[tokio::test]
async fn ports_that_cannot_be_opened_say_why() {
    let directory = tempfile::tempdir().expect("a directory");
    let missing = directory.path().join("ttyNONE");
    let error = SerialLine::open(&config(&missing)).expect_err("missing").to_string();
    assert!(error.contains("ttyNONE: no such port"), "{error}");
    let file = directory.path().join("file");
    std::fs::write(&file, "x").expect("written");
    for path in [file.as_path(), directory.path(), Path::new("/dev/null")] {
        let error = SerialLine::open(&config(path)).expect_err("no terminal").to_string();
        assert!(error.contains("not a serial port") && error.contains(&path.display().to_string()), "{error}");
    }
    let (_master, name) = terminal();
    let first = SerialLine::open(&config(&name)).expect("opens");
    let error = SerialLine::open(&config(&name)).expect_err("in use").to_string();
    assert!(error.contains("in use by another program"), "{error}");
    drop(first);
    SerialLine::open(&config(&name)).expect("free again");
}

/// How often a file is opened while `act` runs.
fn openings(path: &Path, act: impl FnOnce()) -> usize {
    let watcher = inotify::init(inotify::CreateFlags::NONBLOCK).expect("inotify");
    inotify::add_watch(&watcher, path, inotify::WatchFlags::OPEN).expect("watched");
    act();
    let mut buffer = [MaybeUninit::uninit(); 4096];
    let mut events = inotify::Reader::new(&watcher, &mut buffer);
    let mut count = 0;
    while events.next().is_ok() {
        count += 1;
    }
    count
}

#[tokio::test]
async fn a_port_is_opened_once_and_set_up_so_that_closing_it_drops_no_line() {
    let (master, name) = terminal();
    // As a program before left it: cooked, and to hang up when it is closed.
    let mut before = tcgetattr(&master).expect("modes");
    before.control_modes |= ControlModes::HUPCL | ControlModes::CSTOPB;
    before.input_modes |= InputModes::IXON | InputModes::IXANY;
    tcsetattr(&master, OptionalActions::Now, &before).expect("set");
    let mut line = None;
    let count = openings(&name, || line = Some(SerialLine::open(&config(&name)).expect("opens")));
    assert_eq!(count, 1, "each opening may reset a board");
    let modes = tcgetattr(&master).expect("modes");
    assert_eq!(modes.output_speed(), 3_000_000);
    let unwanted = ControlModes::HUPCL | ControlModes::CSTOPB | ControlModes::PARENB | ControlModes::CRTSCTS;
    assert!(!modes.control_modes.intersects(unwanted), "{:?}", modes.control_modes);
    assert!(modes.control_modes.contains(ControlModes::CLOCAL | ControlModes::CREAD | ControlModes::CS8));
    assert!(
        !modes.input_modes.intersects(InputModes::IXON | InputModes::IXOFF | InputModes::IXANY | InputModes::ICRNL)
    );
    assert!(!modes.local_modes.intersects(LocalModes::ECHO | LocalModes::ICANON | LocalModes::ISIG));
    drop(line);
    for (flow_control, control, input) in [
        (FlowControl::RtsCts, ControlModes::CRTSCTS, InputModes::empty()),
        (FlowControl::XonXoff, ControlModes::empty(), InputModes::IXON | InputModes::IXOFF),
    ] {
        // A rate that has no constant of its own.
        let _line = SerialLine::open(&LinkSettings { flow_control, baud: 250_000, ..config(&name) }).expect("opens");
        let modes = tcgetattr(&master).expect("modes");
        assert_eq!((modes.input_speed(), modes.output_speed()), (250_000, 250_000));
        assert!(modes.control_modes.contains(control) && modes.input_modes.contains(input), "{flow_control:?}");
    }
}

#[tokio::test]
async fn a_session_given_up_is_followed_by_another_after_a_pause_that_grows() {
    let (master, name) = terminal();
    let (handle, mut events, driver) = link(config(&name), None, Arc::new(SystemPorts));
    let task = tokio::spawn(driver.run());
    let device = std::thread::spawn(move || run_device(&master, 1));
    let mut sessions = vec![wait_for(&mut events, connected).await];
    let began = Instant::now();
    for _ in 0..4 {
        handle.give_up();
        sessions.push(wait_for(&mut events, connected).await);
    }
    // 100, 200, 400 and 800 ms.
    assert!(began.elapsed() >= Duration::from_millis(1500), "{:?}", began.elapsed());
    handle.renew();
    sessions.push(wait_for(&mut events, connected).await);
    let newest = *sessions.last().expect("six");
    sessions.sort_unstable();
    sessions.dedup();
    assert_eq!(sessions.len(), 6, "each a session of its own");
    handle.room().await;
    handle.try_send(newest, HostMessage::Request { number: 1, request: Request::State }).expect("room");
    wait_for(&mut events, |event| matches!(event, LinkEvent::Session(HostEvent::Message(_))).then_some(())).await;
    assert_eq!(handle.hindrance(newest), None);
    device.join().expect("no panic");
    drop(handle);
    timeout(Duration::from_secs(6), task).await.expect("the driver ends with its handles").expect("no panic");
}
