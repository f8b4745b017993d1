//! Devices that are not the configured one: the operator is told what is configured, what was found and what to do.

mod support;

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use layerd::device::sim::{CoreAction, DeviceCore, SimulateOptions, run};
use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, Encoding, Fault, HostMessage, MachineCapabilities, Report,
    VatCapabilities,
};
use layerd::link::session::SendError;
use layerd_wire::session::{DeviceEvent, DeviceSession, DeviceSettings};
use layerd_wire::{FrameDecoder, FrameKind, HelloRefused, VersionRange, Welcome, encode_frame};
use serialport::{SerialPort, TTYPort};
use support::{Bench, Setup, bench_device, wait_until};

const SMALL: [&str; 8] = ["generate", "bcc", "--struts", "100", "--box", "8,8,1", "-o", "part.layerd"];

/// A device with another picture than the bench's.
fn wide() -> Capabilities {
    let MachineCapabilities::Vat(vat) = bench_device().machine else { panic!("a vat") };
    let machine = MachineCapabilities::Vat(VatCapabilities { width_px: 4096, ..vat });
    Capabilities { name: "wide".into(), max_exposure_ms: 10_000, machine, ..bench_device() }
}

/// The machine that the bench is configured for. It reads raw layers alone: a layer takes several windows.
fn raw_dlp() -> Capabilities {
    Capabilities { name: "raw".into(), encodings: vec![Encoding::RawBit], ..bench_device() }
}

/// Runs a simulated device with these capabilities on the bench's line as long as `host` runs.
fn with_device<T>(bench: &mut Bench, capabilities: Capabilities, host: impl FnOnce(&mut Bench) -> T) -> T {
    let options = SimulateOptions {
        link: bench.path("device"),
        directory: Some(bench.path("device-out")),
        baud: Some(3_000_000),
        escaped: false,
        faults: Vec::new(),
        seed: 1,
        time_scale: 50.0,
        capabilities,
        melt: None,
    };
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let device = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(run(options, || (), async { stopped.await.unwrap_or_default() }))
    });
    wait_until("the device's line", || bench.path("device").exists());
    let result = host(bench);
    drop(stop);
    device.join().expect("no panic").expect("the device runs");
    result
}

/// What `start` says where it takes no job.
fn refused_start(bench: &Bench, arguments: &[&str]) -> String {
    let output = bench.layerctl(&[&["start", "part.layerd"], arguments].concat());
    assert!(!output.status.success() && output.stdout.is_empty(), "no id: {output:?}");
    String::from_utf8(output.stderr).expect("UTF-8")
}

/// The answer to an upload of which nothing comes but its headers.
fn answer_to_headers(bench: &Bench, headers: &str) -> String {
    let mut stream = UnixStream::connect(bench.path("control.sock")).expect("connected");
    let head = format!(
        "POST /v1/jobs HTTP/1.1\r\nhost: layerd\r\nx-layerd-name: big\r\ncontent-length: 1073741824\r\n{headers}\r\n"
    );
    stream.write_all(head.as_bytes()).expect("written");
    // A daemon that waits for the body gives up after 30 s.
    stream.set_read_timeout(Some(Duration::from_secs(25))).expect("a timeout");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer before the body");
    answer
}

fn log_lines(bench: &Bench, part: &str) -> usize {
    let log = std::fs::read_to_string(bench.path("daemon.log")).expect("a log");
    log.lines().filter(|line| line.contains(part)).count()
}

#[test]
fn a_device_of_another_size_is_told_when_it_connects_and_no_job_is_taken_for_it() {
    let mut bench = Bench::prepare(Setup::default());
    bench.ok(&SMALL);
    with_device(&mut bench, wide(), |bench| {
        bench.start_daemon();
        wait_until("the device", || bench.json(&["status"])["link"]["state"] == "connected");
        let is_named = |text: &str| {
            let names = text.contains("`bench`") && text.contains("`wide`") && text.contains("4096 × ");
            assert!(names && text.contains("connect the right device"), "{text}");
        };
        is_named(bench.json(&["status"])["misfit"].as_str().expect("a misfit"));
        is_named(bench.json(&["device"])["misfit"].as_str().expect("a misfit"));
        is_named(&bench.ok(&["status"]));
        is_named(&bench.ok(&["device"]));
        is_named(&refused_start(bench, &[]));
        let answer = answer_to_headers(bench, "");
        assert!(answer.starts_with("HTTP/1.1 409"), "{answer}");
        is_named(&answer);
        assert_eq!(bench.json(&["jobs"])["jobs"].as_array().map(Vec::len), Some(0), "nothing was taken");
        assert_eq!(log_lines(bench, "the device does not fit"), 1, "told once, when it connected");
    });
    assert!(bench.acts().iter().all(|act| act["event"] == "hello"), "{:?}", bench.acts());
    wait_until("the loss", || bench.json(&["status"])["link"]["state"] == "lost");
    assert_eq!(bench.json(&["status"])["misfit"], serde_json::Value::Null, "nothing is connected");
    // Without a device a job is taken. It waits for one that fits, with or without a confirmation.
    let id = bench.start_job("part.layerd");
    with_device(&mut bench, wide(), |bench| {
        let waits = || bench.job(id)["reason"].as_str().is_some_and(|it| it.contains("waits for a device that fits"));
        wait_until("its reason", waits);
        assert_eq!(bench.job(id)["state"], "queued", "{}", bench.job(id));
        let output = bench.layerctl(&["resume", &id.to_string()]);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && text.contains("waits for a device that fits"), "{output:?}");
    });
    wait_until("the loss", || bench.json(&["status"])["link"]["state"] == "lost");
    assert!(bench.acts().iter().all(|act| act["event"] == "hello"), "{:?}", bench.acts());
    let _ = std::fs::remove_file(bench.path("device"));
    bench.start_device();
    let job = bench.wait_for(id, &["failed", "completed", "interrupted"]);
    assert_eq!(job["state"], "completed", "{job}");
}

#[test]
fn a_plate_is_not_taken_to_be_empty_for_a_device_that_does_not_fit() {
    let mut bench = Bench::prepare(Setup { confirm_plate: true, ..Setup::default() });
    bench.ok(&SMALL);
    bench.start_daemon();
    let id = bench.start_job("part.layerd");
    bench.kill_daemon();
    let confirm = |bench: &Bench| bench.layerctl(&["resume", &id.to_string()]);
    with_device(&mut bench, wide(), |bench| {
        bench.start_daemon();
        wait_until("the device", || bench.json(&["status"])["link"]["state"] == "connected");
        let output = confirm(bench);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && text.contains("connect the right device"), "{output:?}");
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(bench.job(id)["state"], "queued", "{}", bench.job(id));
    });
    let _ = std::fs::remove_file(bench.path("device"));
    bench.start_device();
    wait_until("the right device", || {
        bench.json(&["status"])["misfit"].is_null() && bench.json(&["device"])["connected"] == true
    });
    wait_until("the question", || bench.job(id)["reason"].as_str().is_some_and(|it| it.contains("empty plate")));
    let confirmed = confirm(&bench);
    assert!(confirmed.status.success(), "it was not used up: {confirmed:?}");
    bench.wait_for(id, &["completed"]);
}

#[test]
fn another_device_that_comes_in_mid_print_interrupts_the_job_at_once() {
    let mut bench = Bench::start(Setup { exposure_ms: 4_000, time_scale: 10, ..Setup::default() });
    bench.ok(&SMALL);
    let id = bench.start_job("part.layerd");
    wait_until("light", || bench.acts().iter().any(|act| act["event"] == "exposed"));
    bench.kill_device();
    with_device(&mut bench, wide(), |bench| {
        wait_until("the device", || bench.json(&["status"])["link"]["state"] == "connected");
        let began = Instant::now();
        let job = bench.wait_for(id, &["interrupted", "failed", "completed"]);
        assert!(began.elapsed() < Duration::from_secs(20), "at once, not after the minute for a lost line");
        let reason = job["reason"].as_str().expect("a reason");
        assert!(job["state"] == "interrupted" && reason.contains("connect the right device"), "{job}");
        assert!(reason.contains("the plate was not lifted"), "{job}");
    });
    let job = bench.job(id);
    assert_eq!(job["state"], "interrupted", "it waits for the right device: {job}");
}

#[test]
fn a_recipe_longer_than_the_device_allows_is_refused_before_the_job_has_a_number() {
    let mut bench = Bench::prepare(Setup::default());
    bench.ok(&SMALL);
    let recipe = std::fs::read_to_string(bench.path("recipe.toml")).expect("a recipe");
    let slow = recipe.replace("\nexposure_ms = 400", "\nexposure_ms = 10001");
    assert_ne!(slow, recipe);
    std::fs::write(bench.path("slow.toml"), slow).expect("written");
    with_device(&mut bench, Capabilities { machine: bench_device().machine, ..wide() }, |bench| {
        bench.start_daemon();
        wait_until("the device", || bench.json(&["status"])["link"]["state"] == "connected");
        assert_eq!(bench.json(&["status"])["misfit"], serde_json::Value::Null, "the default recipe fits");
        let text = refused_start(bench, &["--recipe", "slow.toml"]);
        assert!(text.contains("10001 ms") && text.contains("at most 10000 ms"), "{text}");
        // Such a recipe is refused before its part comes.
        let slow = std::fs::read(bench.path("slow.toml")).expect("a recipe");
        let encoded: String = slow.iter().map(|byte| format!("%{byte:02X}")).collect();
        let answer = answer_to_headers(bench, &format!("x-layerd-recipe: {encoded}\r\n"));
        assert!(answer.starts_with("HTTP/1.1 422") && answer.contains("at most 10000 ms"), "{answer}");
        let id = bench.start_job("part.layerd");
        assert_eq!(id, 1, "the refused one took no number");
        bench.wait_for(id, &["completed"]);
    });
}

#[test]
fn a_device_of_another_protocol_version_is_named_in_the_status() {
    let device = VersionRange { lowest: 2, highest: 3 };
    let reason = refused_hello(FrameKind::HelloRefused, HelloRefused::Version { device }.encode());
    assert!(reason.contains("the device speaks versions 2 to 3 of the protocol"), "{reason}");
    assert!(reason.contains("this host speaks version 1: update layerd"), "{reason}");
}

#[test]
fn a_machine_of_an_unknown_kind_is_named_in_the_status() {
    let capabilities = bench_device();
    let lists_bytes = capabilities.name.len() + capabilities.encodings.len();
    let mut welcome = Welcome { version: 1, capabilities, state: DeviceState::default() }.encode();
    // Behind version, name, slots, window, largest frame, encodings and longest exposure.
    welcome[2 + 1 + 1 + 4 + 2 + 1 + 4 + lists_bytes] = 4;
    let reason = refused_hello(FrameKind::Welcome, welcome);
    assert!(
        reason.contains("a machine of kind 4, which this host does not know: connect the right device"),
        "{reason}"
    );
}

#[test]
fn a_fault_is_shown_with_the_number_that_the_device_gives_it() {
    let fault = Some(Fault { code: 17, text: "door open".into() });
    let state = DeviceState { fault, ..DeviceState::default() };
    let welcome = Welcome { version: 1, capabilities: bench_device(), state }.encode();
    answering_hellos(FrameKind::Welcome, welcome, |bench| {
        wait_until("the fault", || bench.json(&["device"])["state"]["fault"] == "door open");
        assert_eq!(bench.json(&["device"])["state"]["fault_code"], 17);
        let told = bench.ok(&["device"]);
        assert!(told.contains("FAULT      door open (code 17)\n"), "{told}");
    });
}

/// The daemon's reason for not using a device that answers every hello with this frame.
fn refused_hello(kind: FrameKind, payload: Vec<u8>) -> String {
    answering_hellos(kind, payload, |bench| {
        let reason = || bench.json(&["status"])["link"]["reason"].as_str().unwrap_or_default().to_owned();
        wait_until("the refusal", || reason().contains("the device"));
        reason()
    })
}

/// Runs a daemon on a device that answers every hello with this frame, and says nothing else.
fn answering_hellos<T>(kind: FrameKind, payload: Vec<u8>, look: impl FnOnce(&Bench) -> T) -> T {
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
                    let answer = encode_frame(kind, hello.session_id, 0, &payload);
                    master.write_all(&answer).expect("written");
                }
            }
        }
    });
    bench.start_daemon();
    let found = look(&bench);
    stop.store(true, Ordering::Relaxed);
    device.join().expect("no panic");
    drop(slave);
    found
}

/// A device of the bench's size on a pseudo-terminal of its own, whose every message passes through the test's hands.
struct Peer {
    stop: Arc<AtomicBool>,
    thread: std::thread::JoinHandle<u64>,
}

impl Peer {
    /// `act` is called again and again with what the session delivered last, and counts what it likes.
    fn start(bench: &Bench, mut act: impl FnMut(&mut Wire, Option<DeviceEvent>) -> u64 + Send + 'static) -> Self {
        let (master, slave) = TTYPort::pair().expect("a pseudo-terminal");
        symlink(slave.name().expect("its name"), bench.path("device")).expect("link");
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut wire = Wire::new(master);
            let mut count = 0;
            while !stopped.load(Ordering::Relaxed) {
                wire.listen();
                while !wire.stuck
                    && let Some(event) = wire.session.event()
                {
                    count += act(&mut wire, Some(event));
                }
                count += act(&mut wire, None);
                wire.speak();
            }
            drop(slave);
            count
        });
        Self { stop, thread }
    }

    fn end(self) -> u64 {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("no panic")
    }
}

/// The peer's session and its end of the line.
struct Wire {
    master: TTYPort,
    session: DeviceSession,
    began: Instant,
    /// Takes nothing that the session delivers until a hello comes: what was received fills the window.
    stuck: bool,
    /// Looks for that hello.
    frames: FrameDecoder,
}

impl Wire {
    fn new(mut master: TTYPort) -> Self {
        master.set_timeout(Duration::from_millis(1)).expect("timeout");
        let frames = FrameDecoder::new(1024);
        Self { master, session: Self::session(0), began: Instant::now(), stuck: false, frames }
    }

    fn session(now_us: u64) -> DeviceSession {
        DeviceSession::new(raw_dlp(), DeviceSettings { baud: 3_000_000, escaped: false }, now_us)
    }

    fn now_us(&self) -> u64 {
        self.began.elapsed().as_micros() as u64
    }

    fn listen(&mut self) {
        let mut buffer = [0; 4096];
        // A timeout only means that the host is silent.
        let count = self.master.read(&mut buffer).unwrap_or(0);
        let now_us = self.now_us();
        self.session.receive(&buffer[..count], now_us);
        self.session.handle_timeout(now_us);
        let mut input = &buffer[..count];
        while let Some(frame) = self.frames.next_frame(&mut input) {
            self.stuck &= !frame.is_ok_and(|decoded| decoded.frame.kind == FrameKind::Hello);
        }
    }

    fn speak(&mut self) {
        while let Some(frame) = self.session.transmit(self.now_us()) {
            // A host that reads nothing for so long loses a frame, as on a real line.
            let _ = self.master.write_all(&frame);
        }
    }
}

/// The simulated firmware behind a peer's session, fifty times faster than real.
struct Firmware {
    core: DeviceCore,
    /// Messages that wait for room in the session.
    owed: VecDeque<DeviceMessage>,
}

impl Firmware {
    fn new() -> Self {
        Self { core: DeviceCore::new(raw_dlp(), 1), owed: VecDeque::new() }
    }

    fn take(&mut self, wire: &mut Wire, event: Option<DeviceEvent>) {
        let device_us = 50 * wire.now_us();
        self.core.advance(device_us);
        match event {
            Some(DeviceEvent::Hello { .. }) => {
                self.owed.clear();
                let state = self.core.hello(device_us);
                wire.session.welcome(&state, wire.now_us());
            }
            Some(DeviceEvent::Message(message)) => self.core.handle(message, device_us),
            Some(DeviceEvent::Urgent { number, urgent }) => {
                let light_on = self.core.urgent(urgent, device_us);
                wire.session.urgent_done(number, light_on);
            }
            Some(DeviceEvent::HostSilent) => self.core.host_silent(device_us),
            None => {}
        }
        while let Some(action) = self.core.action() {
            if let CoreAction::Send(message) = action {
                self.owed.push_back(message);
            }
        }
        while self.owed.front().is_some_and(|message| wire.session.send(message) != Err(SendError::Full)) {
            self.owed.pop_front();
        }
    }
}

#[test]
fn a_device_that_reports_without_end_fills_no_log_and_stops_no_print() {
    let mut bench = Bench::prepare(Setup::default());
    bench.ok(&SMALL);
    let mut firmware = Firmware::new();
    let peer = Peer::start(&bench, move |wire, event| {
        firmware.take(wire, event);
        // It works again, it says, without having failed; as often as the line takes it.
        let mut count = 0;
        while firmware.owed.is_empty() && wire.session.send(&DeviceMessage::Report(Report::Fault(None))).is_ok() {
            count += 1;
        }
        count
    });
    bench.start_daemon();
    let id = bench.start_job("part.layerd");
    bench.wait_for(id, &["completed"]);
    wait_until("a word about it", || log_lines(&bench, "the device repeated its fault reports") > 0);
    let reports = peer.end();
    assert!(reports > 1000, "{reports} reports are no flood");
    let lines = log_lines(&bench, "");
    assert!(lines < 100, "{lines} lines for {reports} reports");
}

#[test]
fn a_device_that_frees_no_room_is_told_by_that_and_not_as_a_plate_that_did_not_arrive() {
    let mut bench = Bench::prepare(Setup::default());
    bench.ok(&SMALL);
    let mut firmware = Firmware::new();
    let peer = Peer::start(&bench, move |wire, event| {
        // From the first bytes of a layer on it takes nothing more.
        wire.stuck |= matches!(event, Some(DeviceEvent::Message(HostMessage::LayerData(_))));
        firmware.take(wire, event);
        u64::from(wire.stuck)
    });
    bench.start_daemon();
    let id = bench.start_job("part.layerd");
    wait_until("the hindrance", || {
        let line = bench.json(&["status"])["line"].clone();
        line["hindrance"].as_str().is_some_and(|text| text.contains("states room for"))
    });
    wait_until("the end of the session", || log_lines(&bench, "states room for") > 0);
    bench.ok(&["abort", &id.to_string()]);
    bench.wait_for(id, &["aborted", "failed", "interrupted"]);
    assert_eq!(log_lines(&bench, "check the axis"), 0);
    assert!(peer.end() > 0);
}

#[test]
fn a_device_that_forgets_every_session_is_asked_ever_more_seldom() {
    let mut bench = Bench::prepare(Setup::default());
    let mut forget = false;
    let peer = Peer::start(&bench, move |wire, event| match event {
        Some(DeviceEvent::Hello { .. }) => {
            wire.session.welcome(&DeviceState::default(), wire.now_us());
            wire.speak();
            forget = true;
            1
        }
        _ if std::mem::take(&mut forget) => {
            // What the host says next is of a session that the device does not know.
            wire.session = Wire::session(wire.now_us());
            0
        }
        _ => 0,
    });
    bench.start_daemon();
    let began = Instant::now();
    wait_until("the first loss", || log_lines(&bench, "no longer knows the session") > 0);
    while began.elapsed() < Duration::from_secs(6) {
        std::thread::sleep(Duration::from_millis(100));
    }
    bench.ok(&["status"]);
    let sessions = peer.end();
    // Pauses of 0.1, 0.2, 0.4, 0.8, 1.6 and 3.2 s; without them there were thousands.
    assert!((3..=12).contains(&sessions), "{sessions} sessions");
    let lines = log_lines(&bench, "");
    assert!(lines <= 10 + 4 * sessions as usize, "{lines} lines for {sessions} sessions");
}
