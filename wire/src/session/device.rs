//! The device's end of a session. The simulated devices of `layerd` run it. The [crate's example](crate) does, too.

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::vec::Vec;

use crate::message::{Capabilities, DeviceMessage, DeviceState, HostMessage, Refusal, Reply, Urgent};
use crate::{
    Ack, Decoded, Frame, FrameKind, Hello, HelloRefused, MIN_HOST_FRAME_BYTES, UrgentDone, VERSIONS, Welcome,
    WireError, decode_host_message, decode_urgent, encode_device_message,
};

use super::endpoint::{Endpoint, Terms};
use super::line::Line;
use super::{MAX_URGENTS, SendError, Statistics};

/// Ended sessions that are remembered, so that a delayed hello does not reopen one. The line keeps the order of bytes; only
/// converters on the way can delay a frame, and only slightly.
const RETIRED_SESSIONS: usize = 4;

/// Urgent frames that are remembered, so that a repetition is answered but not carried out again: twice as many as a host repeats.
const REMEMBERED_URGENTS: usize = 2 * MAX_URGENTS;

/// Least time between two NoSession frames: a host may send many frames of an ended session before it notices.
const NO_SESSION_PAUSE_US: u64 = 50_000;

/// Settings of the line at the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeviceSettings {
    /// Line rate, 8N1.
    pub baud: u32,
    /// XON/XOFF is in use, so the bytes 0x11 and 0x13 are escaped.
    pub escaped: bool,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceEvent {
    /// A host opens a session. All messages of the previous session are void. The device must answer with
    /// [`DeviceSession::welcome`]. Repeated for the same session if the welcome was lost.
    Hello {
        /// The session.
        session_id: u32,
    },
    /// A message; each comes once and in order.
    Message(HostMessage),
    /// An urgent order, to be carried out at once and answered with [`DeviceSession::urgent_done`].
    Urgent {
        /// Its number.
        number: u32,
        /// The order.
        urgent: Urgent,
    },
    /// Nothing was heard from the host for 2 s. The session has ended; only a hello starts another.
    HostSilent,
}

/// Sessions as the device sees them, one after the other.
#[derive(Debug)]
pub struct DeviceSession {
    capabilities: Capabilities,
    settings: DeviceSettings,
    line: Line,
    phase: Phase,
    /// Bounded: one hello, [`REMEMBERED_URGENTS`] urgents, one silence.
    events: VecDeque<DeviceEvent>,
    retired: VecDeque<u32>,
    /// Numbers, with the answers once given; at most [`REMEMBERED_URGENTS`].
    urgents: VecDeque<(u32, Option<bool>)>,
    /// Number of the newest hold or release that was carried out.
    last_hold: Option<u32>,
    /// Answers to urgent frames and hellos that wait for the line; at most [`REMEMBERED_URGENTS`] plus three.
    answers: VecDeque<Answer>,
    no_session_after_us: u64,
    now_us: u64,
}

#[derive(Debug)]
enum Phase {
    Closed,
    /// The owner has not yet said welcome.
    Greeted {
        session_id: u32,
        hello: Hello,
        version: u16,
    },
    /// `confirmed` once the host was heard in the session, so it has the welcome.
    Open {
        endpoint: Box<Endpoint>,
        version: u16,
        confirmed: bool,
    },
}

#[derive(Debug, PartialEq, Eq)]
struct Answer {
    kind: FrameKind,
    session_id: u32,
    sequence: u32,
    payload: Vec<u8>,
}

impl DeviceSession {
    /// A device that waits for a hello.
    pub fn new(capabilities: Capabilities, settings: DeviceSettings, now_us: u64) -> Self {
        let line = Line::new(capabilities.largest_frame_bytes.into(), settings.escaped, Statistics::default());
        Self {
            capabilities,
            settings,
            line,
            phase: Phase::Closed,
            events: VecDeque::new(),
            retired: VecDeque::new(),
            urgents: VecDeque::new(),
            last_hold: None,
            answers: VecDeque::new(),
            no_session_after_us: now_us,
            now_us,
        }
    }

    /// Takes bytes from the line, in pieces of any size.
    pub fn receive(&mut self, bytes: &[u8], now_us: u64) {
        self.now_us = now_us;
        for decoded in self.line.receive(bytes) {
            match decoded.frame.kind {
                FrameKind::Hello => self.receive_hello(&decoded.frame),
                FrameKind::Data | FrameKind::Ack | FrameKind::Urgent => self.receive_frame(decoded),
                // Only a device sends these: an echo of its own frames.
                FrameKind::Welcome | FrameKind::HelloRefused | FrameKind::NoSession | FrameKind::UrgentDone => {
                    self.line.statistics.malformed_frames += 1;
                }
            }
        }
    }

    fn receive_hello(&mut self, frame: &Frame) {
        let Ok(hello) = Hello::decode(&frame.payload) else {
            self.line.statistics.malformed_frames += 1;
            return;
        };
        let session_id = frame.session_id;
        let Some(version) = VERSIONS.highest_common(hello.versions) else {
            let refused = HelloRefused::Version { device: VERSIONS };
            return self.answer(FrameKind::HelloRefused, session_id, 0, refused.encode());
        };
        if hello.largest_frame_bytes < MIN_HOST_FRAME_BYTES || hello.window_bytes < u32::from(MIN_HOST_FRAME_BYTES) {
            return self.answer(FrameKind::HelloRefused, session_id, 0, HelloRefused::Limits.encode());
        }
        if self.retired.contains(&session_id) {
            self.line.statistics.stale_frames += 1;
            return;
        }
        match &self.phase {
            Phase::Open { endpoint, confirmed: true, .. } if endpoint.session_id() == session_id => {
                self.line.statistics.stale_frames += 1;
                return;
            }
            Phase::Open { endpoint, confirmed: false, .. } if endpoint.session_id() == session_id => {}
            _ => self.greet(session_id, hello, version),
        }
        let event = DeviceEvent::Hello { session_id };
        if !self.events.contains(&event) {
            self.events.push_back(event);
        }
    }

    /// Ends the old session, if any, and begins a new one.
    fn greet(&mut self, session_id: u32, hello: Hello, version: u16) {
        self.close();
        self.events.clear();
        self.answers.clear();
        self.urgents.clear();
        self.last_hold = None;
        self.phase = Phase::Greeted { session_id, hello, version };
    }

    fn close(&mut self) {
        if let Phase::Open { endpoint, .. } = &self.phase {
            if self.retired.len() >= RETIRED_SESSIONS {
                self.retired.pop_front();
            }
            self.retired.push_back(endpoint.session_id());
        }
        self.phase = Phase::Closed;
    }

    /// Answers a [`DeviceEvent::Hello`]. Does nothing if there was none.
    pub fn welcome(&mut self, state: &DeviceState, now_us: u64) {
        self.now_us = now_us;
        let (session_id, version) = match &self.phase {
            Phase::Closed => return,
            Phase::Open { endpoint, version, .. } => (endpoint.session_id(), *version),
            Phase::Greeted { session_id, hello, version } => {
                let terms = Terms {
                    session_id: *session_id,
                    baud: self.settings.baud,
                    peer_window_bytes: usize::try_from(hello.window_bytes).unwrap_or(usize::MAX),
                    frame_bytes: hello.largest_frame_bytes.into(),
                    own_window_bytes: usize::try_from(self.capabilities.window_bytes).unwrap_or(usize::MAX),
                    first_sequence: 0,
                };
                let (session_id, version) = (*session_id, *version);
                let endpoint = Box::new(Endpoint::new(&terms, now_us));
                self.phase = Phase::Open { endpoint, version, confirmed: false };
                (session_id, version)
            }
        };
        let welcome = Welcome { version, capabilities: self.capabilities.clone(), state: state.clone() };
        self.answer(FrameKind::Welcome, session_id, 0, welcome.encode());
    }

    fn receive_frame(&mut self, decoded: Decoded) {
        let now_us = self.now_us;
        let Frame { kind, session_id, sequence, ref payload } = decoded.frame;
        match &mut self.phase {
            Phase::Open { endpoint, confirmed, .. } if endpoint.session_id() == session_id => {
                *confirmed = true;
                endpoint.heard(now_us);
                match kind {
                    FrameKind::Data => endpoint.receive_data(decoded, &mut self.line, now_us),
                    FrameKind::Ack => match Ack::decode(sequence, payload) {
                        Ok(ack) => {
                            let taken = endpoint.receive_ack(&ack, &mut self.line, now_us);
                            self.line.statistics.malformed_frames += u64::from(taken.is_err());
                        }
                        Err(_) => self.line.statistics.malformed_frames += 1,
                    },
                    _ => match decode_urgent(payload) {
                        Ok(urgent) => self.receive_urgent(sequence, urgent),
                        Err(_) => self.line.statistics.malformed_frames += 1,
                    },
                }
            }
            // The welcome was not sent yet. The host will repeat the frame.
            Phase::Greeted { session_id: greeted, .. } if *greeted == session_id => {}
            _ => {
                self.line.statistics.stale_frames += 1;
                if now_us >= self.no_session_after_us {
                    self.no_session_after_us = now_us + NO_SESSION_PAUSE_US;
                    self.answer(FrameKind::NoSession, session_id, 0, Vec::new());
                }
            }
        }
    }

    fn receive_urgent(&mut self, number: u32, urgent: Urgent) {
        if let Some((_, answer)) = self.urgents.iter().find(|(known, _)| *known == number) {
            // A repetition. If the owner has not answered yet, its answer serves both.
            if let Some(light_on) = *answer {
                self.answer_urgent(number, light_on);
            }
            return;
        }
        if self.urgents.len() >= REMEMBERED_URGENTS {
            self.urgents.pop_front();
        }
        if matches!(urgent, Urgent::Hold | Urgent::Release) {
            // A late one must not undo a newer hold or release. It is only answered.
            if self.last_hold.is_some_and(|last| number.wrapping_sub(last) >= 1 << 31) {
                let light_on = self.urgents.iter().rev().find_map(|(_, answer)| *answer).unwrap_or(false);
                self.urgents.push_back((number, Some(light_on)));
                return self.answer_urgent(number, light_on);
            }
            self.last_hold = Some(number);
        }
        self.urgents.push_back((number, None));
        self.events.push_back(DeviceEvent::Urgent { number, urgent });
        if self.events.len() > REMEMBERED_URGENTS {
            // The owner takes no events. The oldest is dropped; the host repeats it.
            self.events.pop_front();
        }
    }

    /// Answers a [`DeviceEvent::Urgent`] that has been carried out.
    pub fn urgent_done(&mut self, number: u32, light_on: bool) {
        if let Some(entry) = self.urgents.iter_mut().find(|(known, _)| *known == number) {
            entry.1 = Some(light_on);
            self.answer_urgent(number, light_on);
        }
    }

    fn answer_urgent(&mut self, number: u32, light_on: bool) {
        if let Phase::Open { endpoint, .. } = &self.phase {
            let session_id = endpoint.session_id();
            self.answer(FrameKind::UrgentDone, session_id, number, UrgentDone { light_on }.encode());
        }
    }

    /// Queues an answer, unless the same frame waits already; answers to urgent frames go first.
    fn answer(&mut self, kind: FrameKind, session_id: u32, sequence: u32, payload: Vec<u8>) {
        let same = |other: &Answer| (other.kind, other.session_id, other.sequence) == (kind, session_id, sequence);
        self.answers.retain(|other| !same(other));
        // Many refused sessions while the line takes nothing: the oldest answer is useless.
        if self.answers.len() >= REMEMBERED_URGENTS + 3 {
            self.answers.pop_front();
        }
        let answer = Answer { kind, session_id, sequence, payload };
        if kind == FrameKind::UrgentDone {
            let urgents = self.answers.iter().take_while(|other| other.kind == FrameKind::UrgentDone).count();
            self.answers.insert(urgents, answer);
        } else {
            self.answers.push_back(answer);
        }
    }

    /// The next whole frame for the line. Call it only when the line can take a frame.
    pub fn transmit(&mut self, now_us: u64) -> Option<Vec<u8>> {
        self.now_us = now_us;
        if let Some(Answer { kind, session_id, sequence, payload }) = self.answers.pop_front() {
            return Some(self.line.frame(kind, session_id, sequence, &payload));
        }
        match &mut self.phase {
            Phase::Open { endpoint, .. } => endpoint.transmit(&mut self.line, now_us),
            Phase::Closed | Phase::Greeted { .. } => None,
        }
    }

    /// When to call [`Self::handle_timeout`] and [`Self::transmit`] if nothing else happens; `None` without a session.
    pub fn next_timeout_us(&self) -> Option<u64> {
        match &self.phase {
            Phase::Open { endpoint, .. } => Some(endpoint.next_timeout_us()),
            Phase::Closed | Phase::Greeted { .. } => None,
        }
    }

    /// Handles the timers that have run out.
    pub fn handle_timeout(&mut self, now_us: u64) {
        self.now_us = now_us;
        if let Phase::Open { endpoint, .. } = &mut self.phase
            && endpoint.handle_timeout(&mut self.line, now_us)
        {
            self.close();
            self.events.push_back(DeviceEvent::HostSilent);
        }
    }

    /// The next event.
    pub fn event(&mut self) -> Option<DeviceEvent> {
        if let Some(event) = self.events.pop_front() {
            return Some(event);
        }
        loop {
            let Phase::Open { endpoint, .. } = &mut self.phase else { return None };
            match decode_host_message(&endpoint.take_received(self.now_us)?) {
                Ok(message) => return Some(DeviceEvent::Message(message)),
                Err(WireError::BadRequest { number }) => {
                    self.line.statistics.malformed_frames += 1;
                    let reply = DeviceMessage::Reply { number, reply: Reply::Refused(Refusal::Unknown) };
                    // If the queue is full, the host takes no replies, and one more would not help.
                    let _ = endpoint.send(&encode_device_message(&reply), false);
                }
                Err(_) => self.line.statistics.malformed_frames += 1,
            }
        }
    }

    /// Queues a message.
    ///
    /// # Errors
    /// [`SendError`]; then the message is not queued.
    pub fn send(&mut self, message: &DeviceMessage) -> Result<(), SendError> {
        let Phase::Open { endpoint, .. } = &mut self.phase else { return Err(SendError::NotConnected) };
        endpoint.send(&encode_device_message(message), false)
    }

    /// Whether messages can be sent.
    pub fn is_connected(&self) -> bool {
        matches!(self.phase, Phase::Open { .. })
    }

    /// Counts.
    pub fn statistics(&self) -> Statistics {
        self.line.statistics
    }
}
