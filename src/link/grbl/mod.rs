//! A laser machine with a grbl 1.1 or grblHAL controller, as the host of the framed protocol sees it. The controller knows lines of
//! G-code and nothing of layers, so the host plays the part of the machine's firmware: [`GrblSession`] takes the same messages and
//! gives the same events as [`HostSession`](super::session::HostSession). `docs/grbl.md` tells users what they need to know, and
//! `tests/grbl/main.rs` prints with it.
//!
//! | module       | owns                                                                             |
//! |--------------|----------------------------------------------------------------------------------|
//! | `answer`     | lines from the controller                                                         |
//! | `settings`   | what the controller is, checked against the machine                               |
//! | `sender`     | lines to the controller, never more than it has room for; real-time characters    |
//! | `gcode`      | the text of lines                                                                 |
//! | `path`       | the path of the beam, and where on it the beam is                                 |
//! | `marking`    | a layer while it is marked                                                        |
//! | `greeting`   | how a session begins                                                              |
//! | `firmware`   | layers, acts, resets, and what was marked                                         |
//! | `texts`      | what errors and alarms mean                                                       |
//!
//! What is observed on real controllers and shapes this code: nothing counts between a reset and the banner; a reset (0x18) is the
//! only order that makes the laser dark at once; after an error one firmware carries out the lines that follow and the other refuses
//! them, so an error is answered with a reset; a lost byte can change a line without an error, so positions are compared.

mod answer;
mod firmware;
mod gcode;
mod greeting;
mod marking;
mod path;
mod sender;
mod settings;
mod texts;

use std::collections::VecDeque;

use layerd_wire::session::{DEAD_MAN_US, MAX_URGENTS, SendError, Statistics};

use super::message::{HostMessage, Urgent};
use super::session::{HostEvent, LostReason};
use answer::{Answer, Lines};
use firmware::Firmware;
use settings::Told;
pub use settings::{GrblMachine, GrblMisfit};

/// The status is asked for this often, microseconds, while the controller has nothing to do.
const ASK_US: u64 = 500_000;
/// Longest homing, microseconds. grbl 1.1 says nothing meanwhile.
const DEAF_US: u64 = 300_000_000;
/// Longest piece of layer data, bytes.
const PIECE_BYTES: usize = 2048;

/// Where a session is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Waits for any sign of a controller.
    Listening,
    /// Waits until the controller has done what it was sent before.
    Settling,
    /// Waits for the banner.
    Resetting,
    /// Asks what the controller is; so many questions are answered.
    Asking(usize),
    /// Asks where the axes are.
    Locating,
    Open,
    Ended,
}

/// Sessions with a controller, one after the other.
#[derive(Debug)]
pub struct GrblSession {
    session_id: u32,
    phase: Phase,
    /// When the present phase has taken too long.
    give_up_us: u64,
    /// When to ask for the status next, or to send a reset again.
    ask_us: u64,
    heard_us: u64,
    lines: Lines,
    told: Told,
    firmware: Box<Firmware>,
    events: VecDeque<HostEvent>,
    /// Not yet carried out, oldest first; at most [`MAX_URGENTS`].
    urgents: VecDeque<(u32, Urgent)>,
    statistics: Statistics,
    garbage_before: u64,
    /// Banners since the session began.
    banners: u32,
    /// While a session begins: since when the controller has been at rest.
    rests_since_us: Option<u64>,
    /// Whether a status came that does not tell where the axes are.
    lacks_position: bool,
    now_us: u64,
}

impl GrblSession {
    /// The first session. The ids are random: `session_id` tells sessions apart, and `boot_id` processes.
    pub fn new(session_id: u32, boot_id: u32, machine: GrblMachine, now_us: u64) -> Self {
        let mut session = Self {
            session_id,
            phase: Phase::Ended,
            give_up_us: 0,
            ask_us: 0,
            heard_us: now_us,
            lines: Lines::default(),
            told: Told::default(),
            firmware: Box::new(Firmware::new(machine, boot_id)),
            events: VecDeque::new(),
            urgents: VecDeque::new(),
            statistics: Statistics::default(),
            garbage_before: 0,
            banners: 0,
            rests_since_us: None,
            lacks_position: false,
            now_us,
        };
        session.begin(session_id, now_us);
        session
    }

    /// Takes bytes from the line, in pieces of any size.
    pub fn receive(&mut self, bytes: &[u8], now_us: u64) {
        self.now_us = now_us;
        self.statistics.bytes_received += bytes.len() as u64;
        for answer in self.lines.receive(bytes) {
            if matches!(answer, Answer::Garbage(_)) {
                self.statistics.malformed_frames += 1;
            } else {
                self.heard_us = now_us;
            }
            match self.phase {
                Phase::Ended => {}
                Phase::Open => self.hear(answer),
                _ => self.greet(answer),
            }
        }
    }

    /// An answer in an open session.
    fn hear(&mut self, answer: Answer) {
        let now_us = self.now_us;
        match answer {
            Answer::Ok => self.firmware.line_taken(now_us),
            Answer::Error(number) => self.firmware.line_refused(number, now_us),
            Answer::Alarm(number) => self.firmware.alarmed(number, now_us),
            Answer::Status(status) => self.firmware.status(&status, now_us),
            Answer::Garbage(line) => self.firmware.garbage(&line, now_us),
            Answer::Banner(_) => {
                if !self.firmware.started(now_us) {
                    self.lose(LostReason::DeviceForgot);
                }
            }
            Answer::Shift(shift_um) => self.firmware.shifted(shift_um),
            Answer::Modes(modes) => self.firmware.modes(modes),
            Answer::Setting(..) | Answer::Options(..) | Answer::Offset(_) | Answer::Other => {}
        }
    }

    fn lose(&mut self, reason: LostReason) {
        self.phase = Phase::Ended;
        self.events.push_back(HostEvent::Lost(reason));
    }

    /// The next bytes for the line. Call it only when the line can take them.
    pub fn transmit(&mut self, now_us: u64) -> Option<Vec<u8>> {
        self.now_us = now_us;
        if self.phase == Phase::Ended {
            return None;
        }
        let bytes = self.firmware.sender.next(now_us)?;
        self.statistics.bytes_sent += bytes.len() as u64;
        Some(bytes)
    }

    /// When to call [`Self::handle_timeout`] and [`Self::transmit`] if nothing else happens; `None` once the session has ended.
    pub fn next_timeout_us(&self) -> Option<u64> {
        match self.phase {
            Phase::Ended => None,
            Phase::Open => {
                let own_us = self.ask_us.min(self.silent_us());
                Some(own_us.min(self.firmware.next_timeout_us()))
            }
            _ => Some(self.give_up_us.min(self.ask_us)),
        }
    }

    /// When the controller has been silent for too long.
    fn silent_us(&self) -> u64 {
        self.heard_us + if self.firmware.is_deaf() { DEAF_US } else { DEAD_MAN_US }
    }

    /// Handles the timers that have run out.
    pub fn handle_timeout(&mut self, now_us: u64) {
        self.now_us = now_us;
        match self.phase {
            Phase::Ended => {}
            Phase::Open => {
                if now_us >= self.silent_us() || self.firmware.is_flooded() || !self.firmware.tick(now_us) {
                    return self.lose(LostReason::Silent);
                }
                self.ask_status(ASK_US);
            }
            _ => self.greeting_due(),
        }
    }

    fn ask_status(&mut self, every_us: u64) {
        if self.now_us >= self.ask_us {
            self.ask_us = self.now_us + every_us;
            if !self.firmware.is_deaf() {
                self.firmware.sender.ask(self.now_us);
            }
        }
    }

    /// The next event.
    pub fn event(&mut self) -> Option<HostEvent> {
        if let Some(event) = self.events.pop_front() {
            return Some(event);
        }
        if self.phase != Phase::Open {
            return None;
        }
        if let Some(number) = self.firmware.urgent_done() {
            self.urgents.retain(|(pending, _)| *pending != number);
            return Some(HostEvent::UrgentDone { number, light_on: self.firmware.light_on() });
        }
        self.firmware.message().map(HostEvent::Message)
    }

    /// Takes a message.
    ///
    /// # Errors
    /// [`SendError::NotConnected`]; then the message is dropped.
    pub fn send(&mut self, message: &HostMessage) -> Result<(), SendError> {
        if self.phase != Phase::Open {
            return Err(SendError::NotConnected);
        }
        self.firmware.handle(message, self.now_us);
        Ok(())
    }

    /// Carries out an order ahead of everything else, now or once connected. Beyond [`MAX_URGENTS`] unanswered orders, the oldest is
    /// dropped.
    pub fn send_urgent(&mut self, number: u32, urgent: Urgent, now_us: u64) {
        self.now_us = now_us;
        if self.urgents.len() >= MAX_URGENTS {
            self.urgents.pop_front();
        }
        self.urgents.push_back((number, urgent));
        match self.phase {
            Phase::Open => self.firmware.urgent(number, urgent, now_us),
            Phase::Listening | Phase::Settling if is_dark(urgent) => self.press_reset(),
            _ => {}
        }
    }

    /// Whether the next session must not be delayed: an urgent order is not carried out, or the laser is on.
    pub fn is_pressing(&self) -> bool {
        self.firmware.light_on() || !self.urgents.is_empty()
    }

    /// The session's identity.
    pub fn session_id(&self) -> u32 {
        self.session_id
    }

    /// Whether lines wait for room in the controller.
    pub fn has_unsent(&self) -> bool {
        self.firmware.sender.has_waiting()
    }

    /// Counts.
    pub fn statistics(&self) -> Statistics {
        self.statistics
    }
}

/// Whether an order makes the laser dark.
fn is_dark(urgent: Urgent) -> bool {
    matches!(urgent, Urgent::Abort | Urgent::LightOff)
}
