//! The host's end of a session. [`driver`](crate::link::driver) runs it on a port, and `tests/link_session.rs` in virtual time.

mod event;

use std::collections::VecDeque;

pub use event::{HelloRefusal, HostEvent, LostReason};

use layerd_wire::message::{DeviceMessage, DeviceState, HostMessage, Reply, Urgent};
use layerd_wire::session::{
    DEAD_MAN_US, Endpoint, FalseAck, Line, MAX_URGENTS, SendError, Statistics, Terms, line_bytes,
};
use layerd_wire::{
    Ack, Decoded, Frame, FrameKind, Hello, HelloRefused, MAX_SLOTS, MIN_FRAME_BYTES, UrgentDone, VERSIONS, Welcome,
    WireError, decode_device_message, encode_host_message, encode_urgent,
};

use super::hindrance::{Hindrance, Watch};
use super::{HELLO_REPEAT_US, URGENT_REPEAT_US};

/// Largest frame that the host takes. The protocol needs at most 640 bytes.
const MAX_FRAME_BYTES: u16 = 1024;
/// The host's receive buffer: a dozen states.
const WINDOW_BYTES: u32 = 8192;
/// Longest line time of a frame: an urgent frame waits for the frame before it.
const FRAME_TIME_US: u64 = 20_000;

/// Settings of the line at the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostSettings {
    /// Line rate, 8N1.
    pub baud: u32,
    /// XON/XOFF is in use, so the bytes 0x11 and 0x13 are escaped.
    pub escaped: bool,
}

/// One session as the host sees it, from hello to loss. A lost session's [`Self::successor`] starts the next.
#[derive(Debug)]
pub struct HostSession {
    session_id: u32,
    settings: HostSettings,
    line: Line,
    phase: Phase,
    /// Slots of the connected device.
    layer_slots: u8,
    events: VecDeque<HostEvent>,
    /// Not yet answered, oldest first; at most [`MAX_URGENTS`].
    urgents: VecDeque<PendingUrgent>,
    /// The device reported light last.
    lit: bool,
    /// The latest time passed in.
    now_us: u64,
}

#[derive(Debug)]
enum Phase {
    Greeting { hello_at_us: u64, give_up_at_us: u64, garbage_before: u64 },
    // Boxed: the endpoint is many times larger than the rest.
    Open { endpoint: Box<Endpoint>, watch: Watch },
    Ended,
}

#[derive(Clone, Copy, Debug)]
struct PendingUrgent {
    number: u32,
    urgent: Urgent,
    send_at_us: u64,
    sent: bool,
}

impl HostSession {
    /// Begins a session with a hello. `session_id` must be random: it identifies the session to the device.
    pub fn new(session_id: u32, settings: HostSettings, now_us: u64) -> Self {
        Self::begin(session_id, settings, Statistics::default(), now_us)
    }

    fn begin(session_id: u32, settings: HostSettings, statistics: Statistics, now_us: u64) -> Self {
        let garbage_before = statistics.crc_errors + statistics.malformed_frames;
        Self {
            session_id,
            settings,
            line: Line::new(MAX_FRAME_BYTES.into(), settings.escaped, statistics),
            phase: Phase::Greeting { hello_at_us: now_us, give_up_at_us: now_us + DEAD_MAN_US, garbage_before },
            layer_slots: 0,
            events: VecDeque::new(),
            urgents: VecDeque::new(),
            lit: false,
            now_us,
        }
    }

    /// The next session on the same line. It takes over unanswered urgent frames and counts; messages of this session are void.
    #[must_use]
    pub fn successor(&self, session_id: u32, now_us: u64) -> Self {
        let mut next = Self::begin(session_id, self.settings, self.line.statistics, now_us);
        next.urgents = self.urgents.clone();
        next.lit = self.lit;
        for pending in &mut next.urgents {
            pending.send_at_us = now_us;
        }
        next
    }

    /// Takes bytes from the line, in pieces of any size.
    pub fn receive(&mut self, bytes: &[u8], now_us: u64) {
        self.now_us = now_us;
        for decoded in self.line.receive(bytes) {
            if decoded.frame.session_id == self.session_id {
                self.receive_frame(decoded);
            } else {
                self.line.statistics.stale_frames += 1;
            }
        }
    }

    fn receive_frame(&mut self, decoded: Decoded) {
        let now_us = self.now_us;
        let Frame { kind, sequence, ref payload, .. } = decoded.frame;
        match (&mut self.phase, kind) {
            (Phase::Greeting { .. }, FrameKind::Welcome) => match Welcome::decode(payload) {
                Ok(welcome) => self.open(welcome),
                // All of `VERSIONS` were offered, so this one was not.
                Err(WireError::OtherVersion { version }) => {
                    self.refuse(HelloRefusal::NotOffered { host: VERSIONS, chosen: version });
                }
                Err(WireError::UnknownMachine { kind }) => self.refuse(HelloRefusal::UnknownMachine { kind }),
                Err(error) => self.refuse(HelloRefusal::BadWelcome(error)),
            },
            (Phase::Greeting { .. }, FrameKind::HelloRefused) => match HelloRefused::decode(payload) {
                Ok(HelloRefused::Version { device }) if device.is_empty() || device.lowest == 0 => {
                    self.refuse(HelloRefusal::NoVersion { device });
                }
                Ok(HelloRefused::Version { device }) => {
                    self.refuse(HelloRefusal::Version { host: VERSIONS, device });
                }
                Ok(HelloRefused::Limits) => {
                    let (window_bytes, largest_frame_bytes) = (WINDOW_BYTES, MAX_FRAME_BYTES);
                    self.refuse(HelloRefusal::Limits { window_bytes, largest_frame_bytes });
                }
                Err(error) => self.refuse(HelloRefusal::BadRefusal(error)),
            },
            (Phase::Open { .. }, FrameKind::NoSession) => self.lose(LostReason::DeviceForgot),
            (Phase::Open { endpoint, .. }, FrameKind::Data) => {
                endpoint.heard(now_us);
                endpoint.receive_data(decoded, &mut self.line, now_us);
            }
            (Phase::Open { endpoint, watch }, FrameKind::Ack) => {
                endpoint.heard(now_us);
                match Ack::decode(sequence, payload) {
                    Ok(ack) => match endpoint.receive_ack(&ack, &mut self.line, now_us) {
                        Ok(0) => {}
                        Ok(bytes) => watch.acknowledged(bytes, now_us),
                        Err(FalseAck { next_sequence }) => {
                            self.lose(LostReason::FalseAck { acknowledged: sequence, sent: next_sequence });
                        }
                    },
                    Err(_) => self.line.statistics.malformed_frames += 1,
                }
            }
            (Phase::Open { endpoint, .. }, FrameKind::UrgentDone) => {
                endpoint.heard(now_us);
                match UrgentDone::decode(payload) {
                    Ok(done) => self.urgent_done(sequence, done.light_on),
                    Err(_) => self.line.statistics.malformed_frames += 1,
                }
            }
            // A repeated welcome, or a frame after the end of the session.
            _ => {}
        }
    }

    fn open(&mut self, welcome: Welcome) {
        let Welcome { capabilities, mut state, .. } = welcome;
        let (window_bytes, largest_frame_bytes) = (capabilities.window_bytes, capabilities.largest_frame_bytes);
        if largest_frame_bytes < MIN_FRAME_BYTES || window_bytes < u32::from(MIN_FRAME_BYTES) {
            return self.refuse(HelloRefusal::BadLimits { window_bytes, largest_frame_bytes });
        }
        let timely_bytes = line_bytes(FRAME_TIME_US, self.settings.baud).max(MIN_FRAME_BYTES.into());
        let terms = Terms {
            session_id: self.session_id,
            baud: self.settings.baud,
            peer_window_bytes: usize::try_from(window_bytes).unwrap_or(usize::MAX),
            frame_bytes: usize::from(largest_frame_bytes).min(timely_bytes),
            own_window_bytes: WINDOW_BYTES as usize,
            first_sequence: 0,
        };
        self.phase = Phase::Open {
            endpoint: Box::new(Endpoint::new(&terms, self.now_us)),
            watch: Watch::new(self.settings.baud),
        };
        self.layer_slots = capabilities.layer_slots.min(MAX_SLOTS);
        name_every_slot(&mut state, self.layer_slots);
        self.lit = state.light_on || state.exposing.is_some();
        let (session_id, largest_layer_data_bytes) = (self.session_id, self.largest_layer_data_bytes());
        self.events.push_back(HostEvent::Connected { session_id, capabilities, state, largest_layer_data_bytes });
    }

    fn refuse(&mut self, refusal: HelloRefusal) {
        self.phase = Phase::Ended;
        self.events.push_back(HostEvent::Refused(refusal));
    }

    fn lose(&mut self, reason: LostReason) {
        self.phase = Phase::Ended;
        self.events.push_back(HostEvent::Lost(reason));
    }

    fn urgent_done(&mut self, number: u32, light_on: bool) {
        let Some(place) = self.urgents.iter().position(|pending| pending.number == number) else { return };
        let done = self.urgents.remove(place);
        if done.is_some_and(|done| done.urgent == Urgent::Abort) {
            // They are in order. Orders before the abort are obsolete; sent again, they would end later acts.
            self.urgents.drain(..place);
        }
        self.lit = light_on;
        self.events.push_back(HostEvent::UrgentDone { number, light_on });
    }

    /// The next whole frame for the line, urgent frames first. Call it only when the line can take a frame.
    pub fn transmit(&mut self, now_us: u64) -> Option<Vec<u8>> {
        self.now_us = now_us;
        match &mut self.phase {
            Phase::Ended => None,
            Phase::Greeting { hello_at_us, .. } => {
                if now_us < *hello_at_us {
                    return None;
                }
                *hello_at_us = now_us + HELLO_REPEAT_US;
                let hello =
                    Hello { versions: VERSIONS, window_bytes: WINDOW_BYTES, largest_frame_bytes: MAX_FRAME_BYTES };
                Some(self.line.frame(FrameKind::Hello, self.session_id, 0, &hello.encode()))
            }
            Phase::Open { endpoint, .. } => {
                if let Some(pending) = self.urgents.iter_mut().find(|pending| now_us >= pending.send_at_us) {
                    self.line.statistics.repeated_urgents += u64::from(pending.sent);
                    pending.sent = true;
                    pending.send_at_us = now_us + URGENT_REPEAT_US;
                    let payload = encode_urgent(pending.urgent);
                    return Some(self.line.frame(FrameKind::Urgent, self.session_id, pending.number, &payload));
                }
                endpoint.transmit(&mut self.line, now_us)
            }
        }
    }

    /// When to call [`Self::handle_timeout`] and [`Self::transmit`] if nothing else happens; `None` once the session has ended.
    pub fn next_timeout_us(&self) -> Option<u64> {
        match &self.phase {
            Phase::Ended => None,
            Phase::Greeting { hello_at_us, give_up_at_us, .. } => Some(*hello_at_us.min(give_up_at_us)),
            Phase::Open { endpoint, .. } => {
                let urgent = self.urgents.iter().map(|pending| pending.send_at_us).min();
                Some(endpoint.next_timeout_us().min(urgent.unwrap_or(u64::MAX)))
            }
        }
    }

    /// Handles the timers that have run out.
    pub fn handle_timeout(&mut self, now_us: u64) {
        self.now_us = now_us;
        match &mut self.phase {
            Phase::Ended => {}
            Phase::Greeting { give_up_at_us, garbage_before, .. } => {
                if now_us >= *give_up_at_us {
                    let statistics = &self.line.statistics;
                    let garbage_frames = statistics.crc_errors + statistics.malformed_frames - *garbage_before;
                    self.lose(LostReason::NoAnswer { garbage_frames });
                }
            }
            Phase::Open { endpoint, watch } => {
                watch.look(endpoint.queued_bytes() > 0, now_us);
                if endpoint.handle_timeout(&mut self.line, now_us) {
                    self.lose(LostReason::Silent);
                }
            }
        }
    }

    /// The next event.
    pub fn event(&mut self) -> Option<HostEvent> {
        if let Some(event) = self.events.pop_front() {
            return Some(event);
        }
        loop {
            let Phase::Open { endpoint, .. } = &mut self.phase else { return None };
            match decode_device_message(&endpoint.take_received(self.now_us)?) {
                Ok(DeviceMessage::Reply { reply: Reply::State(state), .. })
                    if state.slots.len() > self.layer_slots.into() =>
                {
                    self.phase = Phase::Ended;
                    let error = WireError::BadValue { field: "slots", value: state.slots.len() as u32 };
                    return Some(HostEvent::Lost(LostReason::BadMessage(error)));
                }
                Ok(DeviceMessage::Reply { number, reply: Reply::State(mut state) }) => {
                    name_every_slot(&mut state, self.layer_slots);
                    self.lit = state.light_on || state.exposing.is_some();
                    let reply = Reply::State(state);
                    return Some(HostEvent::Message(DeviceMessage::Reply { number, reply }));
                }
                Ok(message) => return Some(HostEvent::Message(message)),
                // From a newer device. No request waits for it.
                Err(WireError::UnknownReport { .. }) => self.line.statistics.unknown_reports += 1,
                Err(error) => {
                    self.phase = Phase::Ended;
                    return Some(HostEvent::Lost(LostReason::BadMessage(error)));
                }
            }
        }
    }

    /// Queues a message.
    ///
    /// # Errors
    /// [`SendError`]; then the message is not queued.
    pub fn send(&mut self, message: &HostMessage) -> Result<(), SendError> {
        let Phase::Open { endpoint, .. } = &mut self.phase else { return Err(SendError::NotConnected) };
        endpoint.send(&encode_host_message(message), matches!(message, HostMessage::LayerData(_)))
    }

    /// Whether the next session must not be delayed: an urgent order is not answered, or the device reported light last.
    pub fn is_pressing(&self) -> bool {
        self.lit || !self.urgents.is_empty()
    }

    /// What keeps data from getting through although the device is heard; `None` if nothing waits, or not for long.
    pub fn hindrance(&self) -> Option<Hindrance> {
        let Phase::Open { endpoint, watch } = &self.phase else { return None };
        watch.hindrance(endpoint.missing_credit(), self.now_us)
    }

    /// The longest `LayerData` that fits a frame; 0 while not connected.
    pub fn largest_layer_data_bytes(&self) -> usize {
        let Phase::Open { endpoint, .. } = &self.phase else { return 0 };
        // One byte for the kind of message.
        endpoint.payload_limit() - 1
    }

    /// Sends an order that overtakes all data, now or once connected. It is repeated until [`HostEvent::UrgentDone`] answers its number.
    /// Numbers must ascend over all sessions with a device. Beyond [`MAX_URGENTS`] unanswered orders, the oldest is dropped.
    pub fn send_urgent(&mut self, number: u32, urgent: Urgent, now_us: u64) {
        self.now_us = now_us;
        if self.urgents.len() >= MAX_URGENTS {
            self.urgents.pop_front();
        }
        self.urgents.push_back(PendingUrgent { number, urgent, send_at_us: now_us, sent: false });
    }

    /// The session's identity.
    pub fn session_id(&self) -> u32 {
        self.session_id
    }

    /// Whether messages can be sent.
    pub fn is_connected(&self) -> bool {
        matches!(self.phase, Phase::Open { .. })
    }

    /// Whether data waits for credit or for the line.
    pub fn has_unsent(&self) -> bool {
        matches!(&self.phase, Phase::Open { endpoint, .. } if endpoint.has_unsent())
    }

    /// Counts.
    pub fn statistics(&self) -> Statistics {
        self.line.statistics
    }
}

/// A device may leave out the empty slots behind the last one that holds a layer.
fn name_every_slot(state: &mut DeviceState, layer_slots: u8) {
    state.slots.resize(layer_slots.into(), None);
}
