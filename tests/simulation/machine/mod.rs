//! A whole machine in virtual time: the production firmware and the device's end of a session, a lamp, a plate and a character.
//!
//! It never reads a clock. Whatever it says, its [facts](Machine::facts) tell what happened, and [`Machine::is_lit`] and
//! [`Machine::plate_um`] how it is. [`Machine::serve`] joins it to a [`Line`].
#![allow(unreachable_pub, reason = "one module of a test and of an example")]

mod acts;
pub mod character;
mod clock;
mod facts;
mod incident;
mod laser;
mod words;

use std::collections::{BTreeSet, VecDeque};

pub use character::{Character, Draw, Lie, all, of_lasers};
pub use facts::{Fact, FactKind};
pub use incident::{Incident, Interlock};
pub use laser::KnownLayer;

use layerd::device::sim::DeviceCore;
use layerd::layer::Bitmap;
use layerd::link::message::{Capabilities, DeviceMessage, MachineCapabilities, Request};
use layerd_wire::session::{DeviceEvent, DeviceSession, DeviceSettings, SendError};

use super::line::Line;
use super::rng::Rng;
use character::Liar;
use clock::Clock;
use facts::Facts;
use laser::Known;

/// Messages that may wait for room in the session. Beyond this, a host that acknowledges nothing is not heard, as in production.
const MAX_WAITING: usize = 64;
/// While a laser marks, its firmware does what is due so often, microseconds, or when anything else happens. A vector takes milliseconds,
/// and a run a step for each of them.
const LASER_LOOP_US: u64 = 50_000;

/// Light that the firmware did not command.
#[derive(Clone, Copy, Debug)]
struct Stray {
    until_us: u64,
    /// The machine knows of it, says so and can end it.
    is_known: bool,
}

/// Messages that nobody asked for.
#[derive(Clone, Copy, Debug)]
struct Flood {
    next_us: u64,
    left: u32,
    states: bool,
    every_us: u64,
}

/// The machine at the other end of the line.
#[derive(Debug)]
pub struct Machine {
    core: DeviceCore,
    session: DeviceSession,
    settings: DeviceSettings,
    liar: Liar,
    facts: Facts,
    clock: Clock,
    rng: Rng,
    now_us: u64,
    /// When it heard anything from the line last.
    heard_us: u64,
    boot_id: u32,
    /// For the session, once it has room.
    waiting: VecDeque<DeviceMessage>,
    /// For the session, each with its time, the earliest first.
    later: VecDeque<(u64, DeviceMessage)>,
    /// Requests without an answer.
    asked: VecDeque<(u32, Request)>,
    stray: Option<Stray>,
    /// Of the exposure that just ended.
    picture: Option<Bitmap>,
    position_offset_um: i32,
    flood: Option<Flood>,
    reboot_at_us: Option<u64>,
    off_until_us: Option<u64>,
    /// What keeps the light off.
    open: BTreeSet<Interlock>,
    /// What a laser machine knows of layers.
    known: Known,
    /// Whether this session's welcome shows another machine.
    is_other: bool,
}

impl Machine {
    /// A machine that is switched on at time 0: dark, not homed. `baud` is the rate of its line; the seed determines its boot ids.
    pub fn new(capabilities: Capabilities, baud: u32, character: Character, seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        let boot_id = rng.next_u64() as u32;
        let settings = DeviceSettings { baud, escaped: false };
        let reboot_at_us = match character {
            Character::Liar { lie: Lie::Reboots { every_us }, first, .. } => Some(every_us * u64::from(first)),
            _ => None,
        };
        let mut facts = Facts::default();
        facts.note(FactKind::Started { boot_id }, 0);
        Self {
            session: DeviceSession::new(capabilities.clone(), settings, 0),
            core: DeviceCore::new(capabilities, boot_id).telling_vectors(),
            settings,
            liar: Liar::new(character),
            facts,
            clock: Clock::new(),
            rng,
            now_us: 0,
            heard_us: 0,
            boot_id,
            waiting: VecDeque::new(),
            later: VecDeque::new(),
            asked: VecDeque::new(),
            stray: None,
            picture: None,
            position_offset_um: 0,
            flood: None,
            reboot_at_us,
            off_until_us: None,
            open: BTreeSet::new(),
            known: Known::default(),
            is_other: false,
        }
    }

    /// One turn with its line: handles what is due and what has arrived, and sends what the line takes.
    pub fn serve(&mut self, line: &mut Line, now_us: u64) {
        self.handle_timeout(now_us);
        while let Some(bytes) = line.device_reads(now_us) {
            self.receive(&bytes, now_us);
        }
        while line.device_may_send(now_us)
            && let Some(frame) = self.transmit(now_us)
        {
            line.device_sends(&frame, now_us);
        }
    }

    /// Takes bytes from the line; lost while the power is off.
    pub fn receive(&mut self, bytes: &[u8], now_us: u64) {
        self.catch_up(now_us);
        if self.is_on() {
            self.heard_us = now_us;
            self.session.receive(bytes, now_us);
            self.pump(now_us);
        }
    }

    /// The next whole frame. Call it only when the line is free.
    pub fn transmit(&mut self, now_us: u64) -> Option<Vec<u8>> {
        if !self.is_on() {
            return None;
        }
        let frame = self.session.transmit(now_us)?;
        Some(if self.is_other { self.disguise(frame) } else { frame })
    }

    /// Handles everything that is due.
    pub fn handle_timeout(&mut self, now_us: u64) {
        self.catch_up(now_us);
        if self.is_on() {
            self.session.handle_timeout(now_us);
            self.pump(now_us);
        }
    }

    /// When to call [`Self::handle_timeout`] and [`Self::transmit`] next, if the line neither brings anything nor becomes free. Never
    /// a time that was handled already.
    pub fn next_timeout_us(&self) -> Option<u64> {
        // What is overdue waits for the line.
        let session_us = self.session.next_timeout_us().filter(|at_us| self.is_on() && *at_us > self.now_us);
        self.next_own_us().into_iter().chain(session_us).min()
    }

    /// What physically happened since the last call, in order.
    pub fn facts(&mut self) -> impl Iterator<Item = Fact> + use<> {
        self.facts.take().into_iter()
    }

    /// Whether its lamp is on, whatever it says.
    pub fn is_lit(&self) -> bool {
        self.facts.is_lit()
    }

    /// Where its plate was when it was last called with a time, micrometres above the bottom of the vat, also before homing.
    pub fn plate_um(&self) -> i32 {
        self.core.plate_um(self.clock.machine_us(self.now_us))
    }

    /// Whether it knows where its plate is, or is finding out.
    pub fn knows_plate(&self) -> bool {
        let state = self.core.state();
        state.position_um.is_some() || state.moving
    }

    /// When it heard anything from the line last.
    pub fn heard_us(&self) -> u64 {
        self.heard_us
    }

    /// Whether it has power.
    pub fn is_on(&self) -> bool {
        self.off_until_us.is_none()
    }

    /// Whether it never lies.
    pub fn is_honest(&self) -> bool {
        self.character() == Character::Honest
    }

    /// How it lies.
    pub fn character(&self) -> Character {
        self.liar.character
    }

    /// How often it has lied so far.
    pub fn lies_told(&self) -> u32 {
        self.liar.told
    }

    /// Somebody repairs a machine that lies: it is switched off for a moment, and is right from then on.
    pub fn repair(&mut self, now_us: u64) {
        if self.is_honest() {
            return;
        }
        self.liar.character = Character::Honest;
        (self.flood, self.reboot_at_us, self.position_offset_um) = (None, None, 0);
        self.strike(Incident::PowerCut { off_us: 2_500_000 }, now_us);
    }

    fn max_position_um(&self) -> i32 {
        self.core.capabilities().machine.max_position_um()
    }

    fn forget_messages(&mut self) {
        self.waiting.clear();
        self.later.clear();
        self.asked.clear();
    }

    /// When something of the machine itself is due.
    fn next_own_us(&self) -> Option<u64> {
        if self.off_until_us.is_some() {
            return self.off_until_us;
        }
        let times = [
            self.core_due_us().map(|at_us| self.clock.true_us(at_us)),
            self.later.front().map(|(at_us, _)| *at_us),
            self.stray.map(|stray| stray.until_us),
            self.flood.map(|flood| flood.next_us),
            self.reboot_at_us,
        ];
        times.into_iter().flatten().min()
    }

    /// When the firmware is due next, by the machine's clock.
    fn core_due_us(&self) -> Option<u64> {
        let due_us = self.core.next_timeout_us()?;
        let is_marking = self.core.exposure().is_some()
            && matches!(self.core.capabilities().machine, MachineCapabilities::Powder(_));
        Some(if is_marking { due_us.next_multiple_of(LASER_LOOP_US) } else { due_us })
    }

    /// Lets everything happen that is due by now, each at its own time.
    fn catch_up(&mut self, now_us: u64) {
        while let Some(at_us) = self.next_own_us().filter(|at_us| *at_us <= now_us) {
            self.now_us = self.now_us.max(at_us);
            self.happen(self.now_us);
        }
        self.now_us = self.now_us.max(now_us);
    }

    fn happen(&mut self, now_us: u64) {
        if !self.is_on() {
            return self.start(now_us);
        }
        self.core.advance(self.clock.machine_us(now_us));
        self.drain(now_us);
        if self.stray.take_if(|stray| stray.until_us <= now_us).is_some() {
            self.facts.lamp_off(now_us);
        }
        while self.later.front().is_some_and(|(at_us, _)| *at_us <= now_us) {
            self.waiting.extend(self.later.pop_front().map(|(_, message)| message));
        }
        if let Some(flood) = self.flood.filter(|flood| flood.next_us <= now_us) {
            let left = flood.left - 1;
            self.flood = (left > 0).then_some(Flood { next_us: now_us + flood.every_us.max(1), left, ..flood });
            self.flood(flood.states);
        }
        if self.reboot_at_us.take_if(|at_us| *at_us <= now_us).is_some() {
            self.reboot(now_us);
        }
    }

    fn say_now(&mut self, message: DeviceMessage) {
        if self.waiting.len() < MAX_WAITING {
            self.waiting.push_back(message);
        }
    }

    fn say_later(&mut self, at_us: u64, message: DeviceMessage) {
        // What is due has been handled already.
        let at_us = at_us.max(self.now_us + 1);
        let place = self.later.partition_point(|(other_us, _)| *other_us <= at_us);
        self.later.insert(place, (at_us, message));
    }

    /// Passes messages from the session to the firmware, and from the firmware to the session.
    fn pump(&mut self, now_us: u64) {
        loop {
            while let Some(message) = self.waiting.front() {
                if self.session.send(message) == Err(SendError::Full) {
                    break;
                }
                // Sent, or void because its session has ended.
                self.waiting.pop_front();
            }
            if self.waiting.len() >= MAX_WAITING {
                return;
            }
            match self.session.event() {
                None => return,
                Some(DeviceEvent::Hello { session_id }) => self.hello(session_id, now_us),
                Some(DeviceEvent::Message(message)) => self.hear(message, now_us),
                Some(DeviceEvent::Urgent { number, urgent }) => self.urgent(number, urgent, now_us),
                Some(DeviceEvent::HostSilent) => {
                    self.facts.note(FactKind::HostSilent, now_us);
                    self.core.host_silent(self.clock.machine_us(now_us));
                    self.drain(now_us);
                }
            }
        }
    }
}
