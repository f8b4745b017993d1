//! The smallest host that prints on a laser machine: it asks for the state, does what comes next, and goes on with the next vector after
//! each disturbance. It keeps the buffer's credit.

use layerd::link::message::{
    DeviceMessage, DeviceState, HostMessage, PowderReply, PowderRequest, Refusal, Reply, Report, Request,
};
use layerd::link::session::HostSession;

use super::powder::{Sent, id};
use super::{Host, send_all};

pub struct PowderPrinter {
    layers: Vec<Sent>,
    layer_height_um: i32,
    buffer_bytes: u32,
    most_ms: u32,
    state: Option<DeviceState>,
    number: u32,
    /// The request without an answer.
    open: Option<u32>,
    /// The layer whose bytes are being sent, and how many of them were.
    sending: Option<(usize, usize)>,
    sent: u32,
    taken: u32,
    unsent: Option<HostMessage>,
    is_faulty: bool,
    /// What the device said of the interlocks.
    pub faults: Vec<String>,
    /// How often the line was opened.
    pub openings: u32,
    is_done: bool,
}

impl PowderPrinter {
    pub fn new(layers: Vec<Sent>, buffer_bytes: u32, most_ms: u32) -> Self {
        Self {
            layers,
            layer_height_um: 50,
            buffer_bytes,
            most_ms,
            state: None,
            number: 0,
            open: None,
            sending: None,
            sent: 0,
            taken: 0,
            unsent: None,
            is_faulty: false,
            faults: Vec::new(),
            openings: 0,
            is_done: false,
        }
    }

    fn next_message(&mut self, piece_bytes: usize) -> Option<HostMessage> {
        if let Some((layer, at)) = &mut self.sending {
            let credit = (self.buffer_bytes - self.sent.wrapping_sub(self.taken)) as usize;
            let rest = &self.layers[*layer].bytes[*at..];
            let piece = &rest[..rest.len().min(credit).min(piece_bytes)];
            if !piece.is_empty() {
                *at += piece.len();
                self.sent = self.sent.wrapping_add(piece.len() as u32);
                return Some(HostMessage::LayerData(piece.to_vec()));
            }
        }
        if self.open.is_some() || self.is_faulty || self.is_done {
            return None;
        }
        let request = match self.state.take() {
            None => Request::State,
            Some(state) => self.next_request(&state)?,
        };
        self.number += 1;
        self.open = Some(self.number);
        Some(HostMessage::Request { number: self.number, request })
    }

    fn next_request(&mut self, state: &DeviceState) -> Option<Request> {
        if state.exposing.is_some() || state.moving {
            return Some(Request::State);
        }
        let layer = state.last_exposed.map_or(0, |last| last.layer + 1);
        let Some(encoded) = self.layers.get(layer as usize) else {
            self.is_done = true;
            return None;
        };
        let powder = state.powder.expect("a laser machine");
        let depth_um = (layer as i32 + 1) * self.layer_height_um;
        Some(match state.position_um {
            None => Request::Powder(PowderRequest::Home),
            Some(position_um) if position_um != depth_um => {
                Request::Powder(PowderRequest::Move { position_um: depth_um, speed_um_s: 5000 })
            }
            Some(_) if !powder.recoated => Request::Powder(PowderRequest::Recoat),
            Some(_) if !state.slots.contains(&Some(id(layer))) => {
                self.sending = Some((layer as usize, 0));
                Request::LayerBegin {
                    slot: (layer % 2) as u8,
                    id: id(layer),
                    encoding: encoded.encoding,
                    encoded_bytes: encoded.bytes.len() as u32,
                    decoded_crc32: encoded.crc32,
                }
            }
            Some(_) => {
                let is_continued = state.cut_short.is_some_and(|(cut, _)| cut == id(layer));
                let from_vector = if is_continued { powder.next_vector } else { 0 };
                Request::Powder(PowderRequest::Mark { id: id(layer), from_vector, most_ms: self.most_ms })
            }
        })
    }
}

impl Host for PowderPrinter {
    fn is_done(&self) -> bool {
        self.is_done
    }

    fn opened(&mut self) {
        self.openings += 1;
    }

    fn connected(&mut self, state: &DeviceState) {
        self.is_faulty = state.fault.is_some();
        assert!(state.slots.iter().all(Option::is_none), "a session begins with an empty buffer");
        self.state = Some(state.clone());
        (self.open, self.sending, self.unsent, self.sent, self.taken) = (None, None, None, 0, 0);
    }

    fn lost(&mut self) {
        self.state = None;
        // Nothing is sent before the next welcome.
        self.open = Some(0);
    }

    fn message(&mut self, message: DeviceMessage) {
        match message {
            DeviceMessage::Report(Report::Room { taken_bytes }) => self.taken = taken_bytes,
            DeviceMessage::Report(Report::Fault(fault)) => {
                self.is_faulty = fault.is_some();
                self.faults.extend(fault.map(|fault| fault.text));
            }
            DeviceMessage::Reply { number, reply } => {
                assert_eq!(self.open.take(), Some(number), "{reply:?}");
                match reply {
                    Reply::State(state) => self.state = Some(state),
                    Reply::Refused(Refusal::CutShort | Refusal::NotReady | Refusal::BadLayer) => self.sending = None,
                    Reply::Done
                    | Reply::Powder(PowderReply::Moved { .. } | PowderReply::Recoated | PowderReply::Marked { .. }) => {
                    }
                    other => panic!("{other:?}"),
                }
            }
        }
    }

    fn work(&mut self, session: &mut HostSession) {
        let mut unsent = self.unsent.take();
        send_all(session, &mut unsent, |piece_bytes| self.next_message(piece_bytes));
        self.unsent = unsent;
    }
}
