//! The smallest host at the end of a [`Line`] to a [`Machine`], in virtual time: it sends what a test asks for and keeps what it
//! hears.

use std::collections::VecDeque;

use layerd::device::encoding::{encode, picture_crc32};
use layerd::layer::{Bitmap, Depth};
use layerd::link::message::{
    Capabilities, DeviceMessage, DeviceState, Encoding, ExposureId, HostMessage, MachineCapabilities, Reply, Request,
    Urgent, VatCapabilities, VatReply, VatRequest, Vats,
};
use layerd::link::session::{HostEvent, HostSession, HostSettings, SendError};

use crate::line::Line;
use crate::machine::{Character, Fact, FactKind, Lie, Machine};
use crate::parts::BAUD;

pub(crate) const EXPOSURE_MS: u32 = 400;
pub(crate) const CLEAR_UM: i32 = 30_000;
const LAYER_UM: i32 = 50;
const SPEED_UM_S: u32 = 20_000;
/// Longest wait for an answer of a machine that gives one.
const PATIENCE_US: u64 = 60_000_000;
const SECOND_US: u64 = 1_000_000;

pub(crate) fn capabilities() -> Capabilities {
    Capabilities {
        name: "bench".into(),
        layer_slots: 2,
        window_bytes: 4096,
        largest_frame_bytes: 1024,
        encodings: vec![Encoding::RawBit],
        max_exposure_ms: 60_000,
        machine: MachineCapabilities::Vat(VatCapabilities {
            width_px: 160,
            height_px: 100,
            pixel_nm: [50_000; 2],
            max_position_um: 60_000,
            vats: Vats::ONE,
        }),
    }
}

pub(crate) fn id(layer: u32) -> ExposureId {
    ExposureId::first_pass(7, layer)
}

/// A picture that no other layer has.
pub(crate) fn picture(layer: u32) -> Bitmap {
    let mut bitmap = Bitmap::new(160, 100, Depth::Bit);
    for (index, byte) in bitmap.data_mut().iter_mut().enumerate() {
        *byte = (index as u32 + layer * 7).wrapping_mul(2_654_435_761).to_be_bytes()[0];
    }
    bitmap
}

pub(crate) struct Bench {
    pub(crate) machine: Machine,
    pub(crate) line: Line,
    pub(crate) now_us: u64,
    /// What the machine said, and when.
    pub(crate) heard: Vec<(u64, DeviceMessage)>,
    pub(crate) welcomes: Vec<(Capabilities, DeviceState)>,
    /// Answers to urgent orders.
    pub(crate) urgents: Vec<(u32, bool)>,
    pub(crate) facts: Vec<Fact>,
    pub(crate) steps: u64,
    /// Whether the next session begins at once when one was lost.
    pub(crate) reconnects: bool,
    host: HostSession,
    queue: VecDeque<HostMessage>,
    output: Vec<u8>,
    number: u32,
    last_urgent: u32,
}

impl Bench {
    pub(crate) fn new(character: Character, seed: u64) -> Self {
        Self::with(Machine::new(capabilities(), BAUD, character, seed), seed)
    }

    /// With any machine. The seed determines the line.
    pub(crate) fn with(machine: Machine, seed: u64) -> Self {
        Self {
            machine,
            line: Line::new(BAUD, seed),
            now_us: 0,
            heard: Vec::new(),
            welcomes: Vec::new(),
            urgents: Vec::new(),
            facts: Vec::new(),
            steps: 0,
            reconnects: true,
            host: HostSession::new(1, HostSettings { baud: BAUD, escaped: false }, 0),
            queue: VecDeque::new(),
            output: Vec::new(),
            number: 0,
            last_urgent: 0,
        }
    }

    /// A machine that lies from the first occasion on, homed and clear of the resin, with layer 0 in slot 0.
    pub(crate) fn lying(lie: Lie, first: u32, count: u32) -> Self {
        let mut bench = Self::new(Character::Liar { lie, first, count }, 5);
        bench.run_until(|bench| !bench.welcomes.is_empty());
        bench.request(Request::Vat(VatRequest::Home));
        bench.run_for(3 * SECOND_US);
        bench.move_to(CLEAR_UM);
        bench.upload(0, 0);
        bench.run_for(3 * SECOND_US);
        bench
    }

    /// One turn: everything that is due now. Then the time goes on to what comes next.
    pub(crate) fn step(&mut self) {
        let now_us = self.now_us;
        self.steps += 1;
        self.machine.serve(&mut self.line, now_us);
        self.facts.extend(self.machine.facts());
        self.host.handle_timeout(now_us);
        self.host.receive(&self.line.host_reads(4096, now_us), now_us);
        self.take_events();
        self.write();
        let host_us = self.host.next_timeout_us().filter(|at_us| *at_us > now_us);
        let next_us = [self.machine.next_timeout_us(), self.line.next_us(now_us), host_us];
        let next_us = next_us.into_iter().flatten().min().unwrap_or(now_us + SECOND_US);
        assert!(next_us > now_us, "the time stands still at {now_us}");
        self.now_us = next_us;
    }

    fn take_events(&mut self) {
        while let Some(event) = self.host.event() {
            match event {
                HostEvent::Connected { capabilities, state, .. } => self.welcomes.push((capabilities, state)),
                HostEvent::Message(message) => self.heard.push((self.now_us, message)),
                HostEvent::UrgentDone { number, light_on } => self.urgents.push((number, light_on)),
                HostEvent::Lost(_) if self.reconnects => self.renew(),
                HostEvent::Lost(_) => {}
                HostEvent::Refused(refusal) => panic!("{refusal:?}"),
            }
        }
    }

    fn write(&mut self) {
        while let Some(message) = self.queue.front() {
            match self.host.send(message) {
                Err(SendError::Full | SendError::NotConnected) => break,
                other => other.expect("a message that fits"),
            }
            self.queue.pop_front();
        }
        loop {
            if self.output.is_empty() {
                let Some(frame) = self.host.transmit(self.now_us) else { return };
                self.output = frame;
            }
            let count = self.line.host_writes(&self.output, self.now_us);
            if !self.line.is_up(self.now_us) {
                self.output.clear();
            }
            if count == 0 {
                return;
            }
            self.output.drain(..count);
        }
    }

    /// Begins another session.
    pub(crate) fn renew(&mut self) {
        self.host = self.host.successor(self.host.session_id() + 1, self.now_us);
        self.queue.clear();
        self.number = 0;
    }

    pub(crate) fn run_for(&mut self, us: u64) {
        let end_us = self.now_us + us;
        while self.now_us < end_us {
            self.step();
        }
    }

    /// Runs until it is so; fails if that takes longer than a machine may.
    pub(crate) fn run_until(&mut self, is_so: impl Fn(&Self) -> bool) {
        let end_us = self.now_us + PATIENCE_US;
        while !is_so(self) {
            assert!(self.now_us < end_us, "nothing happened: {:?}", self.heard);
            self.step();
        }
    }

    pub(crate) fn request(&mut self, request: Request) -> u32 {
        self.number += 1;
        self.queue.push_back(HostMessage::Request { number: self.number, request });
        self.number
    }

    pub(crate) fn urgent(&mut self, urgent: Urgent) -> u32 {
        self.last_urgent += 1;
        self.host.send_urgent(self.last_urgent, urgent, self.now_us);
        self.last_urgent
    }

    /// Sends a request and waits for its answer.
    pub(crate) fn ask(&mut self, request: Request) -> Reply {
        let number = self.request(request);
        self.answer(number)
    }

    pub(crate) fn answer(&mut self, number: u32) -> Reply {
        let is_it = move |message: &DeviceMessage| matches!(message, DeviceMessage::Reply { number: found, .. } if *found == number);
        let since = self.heard.len();
        self.run_until(|bench| bench.heard[since..].iter().any(|(_, message)| is_it(message)));
        let (_, message) = self.heard[since..].iter().find(|(_, message)| is_it(message)).expect("it came").clone();
        let DeviceMessage::Reply { reply, .. } = message else { panic!("{message:?}") };
        reply
    }

    pub(crate) fn state(&mut self) -> DeviceState {
        let reply = self.ask(Request::State);
        let Reply::State(state) = reply else { panic!("{reply:?}") };
        state
    }

    pub(crate) fn upload(&mut self, slot: u8, layer: u32) -> u32 {
        let mut bytes = Vec::new();
        encode(&picture(layer), Encoding::RawBit, &mut bytes).expect("bits");
        self.send_layer(slot, layer, (Encoding::RawBit, &bytes, picture_crc32(&picture(layer))))
    }

    /// Sends a layer: its encoding, bytes and checksum. Whether there is room for it is the caller's matter.
    pub(crate) fn send_layer(&mut self, slot: u8, layer: u32, (encoding, bytes, crc32): (Encoding, &[u8], u32)) -> u32 {
        let number = self.request(Request::LayerBegin {
            slot,
            id: id(layer),
            encoding,
            encoded_bytes: bytes.len() as u32,
            decoded_crc32: crc32,
        });
        self.queue.extend(bytes.chunks(900).map(|piece| HostMessage::LayerData(piece.to_vec())));
        number
    }

    pub(crate) fn move_to(&mut self, position_um: i32) -> u32 {
        self.request(Request::Vat(VatRequest::Move { position_um, speed_um_s: SPEED_UM_S }))
    }

    pub(crate) fn expose(&mut self, layer: u32) -> u32 {
        self.request(Request::Vat(VatRequest::Expose { id: id(layer), duration_ms: EXPOSURE_MS, light_pwm: 255 }))
    }

    /// Prints layers from 0 on: sends each, moves the plate down, exposes, moves it up.
    pub(crate) fn print(&mut self, layers: u32) {
        self.run_until(|bench| !bench.welcomes.is_empty());
        assert_eq!(self.ask(Request::Vat(VatRequest::Home)), Reply::Vat(VatReply::Moved { position_um: 0 }));
        for layer in 0..layers {
            let sent = self.upload((layer % 2) as u8, layer);
            assert_eq!(self.answer(sent), Reply::Done);
            let position_um = LAYER_UM * (layer as i32 + 1);
            let down = self.move_to(position_um);
            assert_eq!(self.answer(down), Reply::Vat(VatReply::Moved { position_um }));
            let lit = self.expose(layer);
            let exposed = VatReply::Exposed { id: id(layer), duration_ms: EXPOSURE_MS };
            assert_eq!(self.answer(lit), Reply::Vat(exposed));
            let up = self.move_to(position_um + 3_000);
            assert!(matches!(self.answer(up), Reply::Vat(VatReply::Moved { .. })));
        }
        self.facts.extend(self.machine.facts());
    }

    /// Prints layer 0, and has layer 1 under light.
    pub(crate) fn light_layer_1(&mut self) {
        self.print(1);
        let sent = self.upload(0, 1);
        self.answer(sent);
        self.expose(1);
        self.run_until(|bench| bench.machine.is_lit());
    }

    /// How long each light was, µs.
    pub(crate) fn lights_us(&self) -> Vec<u64> {
        let lit = |fact: &Fact| if let FactKind::LightOff { lit_us, .. } = fact.what { Some(lit_us) } else { None };
        self.facts.iter().filter_map(lit).collect()
    }

    /// The layers that ran their whole time.
    pub(crate) fn exposed(&self) -> Vec<u32> {
        let layer = |fact: &Fact| match &fact.what {
            FactKind::ExposedWhole { id: exposed, picture: seen, .. } => {
                assert_eq!(*seen, picture(exposed.layer));
                Some(exposed.layer)
            }
            _ => None,
        };
        self.facts.iter().filter_map(layer).collect()
    }

    pub(crate) fn saw(&self, is_it: impl Fn(&FactKind) -> bool) -> usize {
        self.facts.iter().filter(|fact| is_it(&fact.what)).count()
    }
}
