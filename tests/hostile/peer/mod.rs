//! A DLP machine that lies: the session and the firmware of the simulated device on a pseudo-terminal of the test's own, and
//! between them a script that may change what the device is asked, what it does and what it says.
//!
//! The peer writes down what reached it, what it said of its light, and when there was light, by its own clock.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

mod line;
mod stage;

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use layerd::device::sim::{CoreAction, DeviceCore};
use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, HostMessage, Reply, Request, Urgent, VatRequest,
};
use layerd::link::session::SendError;
use layerd_wire::session::{DeviceEvent, DeviceSession, DeviceSettings};
use line::Line;
pub use stage::{CLEAR_UM, EXPOSURE_MS, LAYER_UM, LIFT_UM, PATIENCE, Stage, side_by_side};

use crate::support::bench_device;

/// As the bench's machine file states it.
const BAUD: u32 = 3_000_000;
/// Where the firmware's clock stands when the line opens: before that it homed and went clear of the resin.
const SET_UP_US: u64 = 5_000_000;

/// What a script may turn on and off.
#[derive(Debug, Default)]
pub struct Controls {
    /// There is light that the firmware knows nothing of.
    pub stray: Option<Stray>,
    /// Cut the line: after so many milliseconds, for so many.
    pub cut_line: Option<(u64, u64)>,
    /// Start the device anew, with this boot id.
    pub restart: Option<u32>,
    /// Set by a script that lies only once.
    pub lied: bool,
}

impl Controls {
    /// True the first time.
    pub fn once(&mut self) -> bool {
        !std::mem::replace(&mut self.lied, true)
    }
}

/// Light beside the firmware's own.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stray {
    /// How many orders to be dark it outlasts.
    pub outlasts: u32,
}

/// Where a script may step in.
#[derive(Debug)]
pub enum Moment<'a> {
    /// A request came. The firmware gets what the script leaves of it.
    Asked(&'a mut Option<Request>),
    /// The firmware answers that request, as it came. The host gets what the script leaves, by number.
    Answers(&'a Request, &'a mut Vec<(u32, Reply)>),
    /// The state is told, in a welcome or a reply.
    Tells(&'a mut DeviceState),
    /// An urgent order was carried out: whether there is light now, or `None` for no answer.
    Obeys(Urgent, &'a mut Option<bool>),
}

/// What a test makes of the device.
pub type Script = Box<dyn FnMut(&mut Controls, Moment<'_>) + Send>;

/// What the peer saw, in its order.
#[derive(Clone, Debug, PartialEq)]
pub enum Seen {
    /// A session begins.
    Hello,
    /// As it came.
    Asked(Request),
    /// An urgent order, once a session.
    Urgent(u32, Urgent),
    /// There is light, or there is none any more.
    Light(bool),
    /// What the host was told of the light.
    SaidLight(bool),
    /// The light of a layer began: only a layer that is exposed twice is here twice.
    Lit(u32),
    /// The plate arrived.
    Arrived(i32),
    /// The script lied, for the first time.
    Lied,
}

/// One entry of what the peer saw.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// By the peer's clock.
    pub at_ms: u64,
    /// What.
    pub seen: Seen,
}

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    log: Mutex<Vec<Entry>>,
    controls: Mutex<Controls>,
}

/// The running device; it ends when this is dropped.
pub struct Peer {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Peer {
    /// Puts a device on the line `link`, homed and clear of the resin, as an operator leaves one.
    pub fn start(link: &Path, script: Script) -> Self {
        let shared = Arc::new(Shared::default());
        let mut device = Device::new(link, script, Arc::clone(&shared));
        let thread = std::thread::spawn(move || {
            while !device.shared.stop.load(Ordering::Relaxed) {
                device.turn();
            }
        });
        Self { shared, thread: Some(thread) }
    }

    /// What it saw up to now.
    pub fn log(&self) -> Vec<Entry> {
        lock(&self.shared.log).clone()
    }

    /// Changes what the script controls, from outside.
    pub fn control(&self, change: impl FnOnce(&mut Controls)) {
        change(&mut lock(&self.shared.controls));
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        if !std::thread::panicking() {
            ended.expect("it was started").expect("the peer does not panic");
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn capabilities() -> Capabilities {
    Capabilities { name: "hostile".into(), ..bench_device() }
}

/// A firmware that has found its zero position and waits above the resin.
fn set_up() -> DeviceCore {
    let mut core = DeviceCore::new(capabilities(), 1);
    core.hello(0);
    core.handle(HostMessage::Request { number: 1, request: Request::Vat(VatRequest::Home) }, 0);
    let clear = Request::Vat(VatRequest::Move { position_um: CLEAR_UM, speed_um_s: 1_000_000 });
    core.handle(HostMessage::Request { number: 2, request: clear }, SET_UP_US / 2);
    core.advance(SET_UP_US);
    while core.action().is_some() {}
    assert_eq!(core.state().position_um, Some(CLEAR_UM));
    core
}

struct Device {
    script: Script,
    shared: Arc<Shared>,
    started: Instant,
    session: DeviceSession,
    core: DeviceCore,
    line: Line,
    /// When to cut it, and for how long.
    cut_at_us: Option<(u64, u64)>,
    /// Requests of the session that are not answered yet.
    open: HashMap<u32, Request>,
    outgoing: Vec<DeviceMessage>,
    is_lit: bool,
}

impl Device {
    fn new(link: &Path, script: Script, shared: Arc<Shared>) -> Self {
        Self {
            script,
            shared,
            started: Instant::now(),
            session: new_session(SET_UP_US),
            core: set_up(),
            line: Line::open(link),
            cut_at_us: None,
            open: HashMap::new(),
            outgoing: Vec::new(),
            is_lit: false,
        }
    }

    fn now_us(&self) -> u64 {
        SET_UP_US + self.started.elapsed().as_micros() as u64
    }

    fn turn(&mut self) {
        let mut now_us = self.now_us();
        self.core.advance(now_us);
        self.session.handle_timeout(now_us);
        self.apply_controls(now_us);
        self.pump(now_us);
        while let Some(frame) = self.line.wants_frame().then(|| self.session.transmit(now_us)).flatten() {
            self.line.write(&frame);
        }
        let received = self.line.read();
        now_us = self.now_us();
        self.session.receive(&received, now_us);
        self.line.reopen(now_us);
    }

    fn apply_controls(&mut self, now_us: u64) {
        let (cut_line, restart) = {
            let mut controls = lock(&self.shared.controls);
            (controls.cut_line.take(), controls.restart.take())
        };
        if let Some((after_ms, for_ms)) = cut_line {
            self.cut_at_us = Some((now_us + after_ms * 1000, for_ms * 1000));
        }
        if let Some((_, for_us)) = self.cut_at_us.take_if(|(at_us, _)| *at_us <= now_us) {
            self.line.cut(now_us + for_us);
        }
        if let Some(boot_id) = restart {
            self.session = new_session(now_us);
            self.outgoing.clear();
            self.core.reset(boot_id, now_us);
        }
    }

    fn pump(&mut self, now_us: u64) {
        loop {
            self.act();
            let sent = self.outgoing.iter().take_while(|message| self.session.send(message) != Err(SendError::Full));
            let sent = sent.count();
            self.outgoing.drain(..sent);
            let Some(event) = self.session.event() else { return };
            match event {
                DeviceEvent::Hello { .. } => {
                    self.note(Seen::Hello);
                    self.outgoing.clear();
                    self.open.clear();
                    self.core.hello(now_us);
                    let state = self.told_state();
                    self.session.welcome(&state, now_us);
                }
                DeviceEvent::Message(HostMessage::Request { number, request }) => self.asked(number, request, now_us),
                DeviceEvent::Message(message) => self.core.handle(message, now_us),
                DeviceEvent::Urgent { number, urgent } => self.obey(number, urgent, now_us),
                DeviceEvent::HostSilent => {
                    self.core.host_silent(now_us);
                    self.line.release();
                }
            }
        }
    }

    fn asked(&mut self, number: u32, request: Request, now_us: u64) {
        self.note(Seen::Asked(request));
        self.open.insert(number, request);
        let mut left = Some(request);
        self.step_in(Moment::Asked(&mut left));
        if let Some(request) = left {
            self.core.handle(HostMessage::Request { number, request }, now_us);
        }
    }

    fn obey(&mut self, number: u32, urgent: Urgent, now_us: u64) {
        self.note(Seen::Urgent(number, urgent));
        let lit = self.core.urgent(urgent, now_us);
        let is_stray = {
            let mut controls = lock(&self.shared.controls);
            controls.stray = match controls.stray {
                Some(Stray { outlasts: 0 }) => None,
                stray => stray.map(|Stray { outlasts }| Stray { outlasts: outlasts - 1 }),
            };
            controls.stray.is_some()
        };
        let mut answer = Some(lit || is_stray);
        self.step_in(Moment::Obeys(urgent, &mut answer));
        // What runs was ended: its answer follows the urgent one.
        self.act();
        if let Some(light_on) = answer {
            self.note(Seen::SaidLight(light_on));
            self.session.urgent_done(number, light_on);
        }
    }

    /// Does what the firmware asks for, and lets the script change its answers.
    fn act(&mut self) {
        while let Some(action) = self.core.action() {
            match action {
                CoreAction::Send(DeviceMessage::Reply { number, reply }) => self.answer(number, reply),
                CoreAction::Send(message) => self.outgoing.push(message),
                CoreAction::Record(record) => match (record.event, record.layer, record.position_um) {
                    ("light_on", Some(layer), _) => self.note(Seen::Lit(layer)),
                    ("moved", _, Some(position_um)) => self.note(Seen::Arrived(position_um)),
                    _ => {}
                },
                CoreAction::Picture(..) | CoreAction::Vector(_) => {}
            }
        }
        let is_lit = self.core.state().light_on || lock(&self.shared.controls).stray.is_some();
        if std::mem::replace(&mut self.is_lit, is_lit) != is_lit {
            self.note(Seen::Light(is_lit));
        }
    }

    fn answer(&mut self, number: u32, reply: Reply) {
        let Some(request) = self.open.remove(&number) else { return };
        let reply = if let Reply::State(_) = reply { Reply::State(self.told_state()) } else { reply };
        let mut answers = vec![(number, reply)];
        self.step_in(Moment::Answers(&request, &mut answers));
        self.outgoing.extend(answers.into_iter().map(|(number, reply)| DeviceMessage::Reply { number, reply }));
    }

    fn told_state(&mut self) -> DeviceState {
        let mut state = self.core.state();
        state.light_on |= lock(&self.shared.controls).stray.is_some();
        self.step_in(Moment::Tells(&mut state));
        self.note(Seen::SaidLight(state.light_on));
        state
    }

    fn step_in(&mut self, moment: Moment<'_>) {
        let mut controls = lock(&self.shared.controls);
        let lied = controls.lied;
        (self.script)(&mut controls, moment);
        if controls.lied && !lied {
            self.note(Seen::Lied);
        }
    }

    fn note(&self, seen: Seen) {
        let at_ms = self.started.elapsed().as_millis() as u64;
        lock(&self.shared.log).push(Entry { at_ms, seen });
    }
}

fn new_session(now_us: u64) -> DeviceSession {
    DeviceSession::new(capabilities(), DeviceSettings { baud: BAUD, escaped: false }, now_us)
}

/// Waits for what the peer sees; `false` when it does not come in time.
pub fn soon(patience: Duration, condition: impl Fn() -> bool) -> bool {
    let began = Instant::now();
    while !condition() {
        if began.elapsed() > patience {
            return false;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    true
}

/// A script that changes nothing.
pub fn honest() -> Script {
    Box::new(|_, _| {})
}
