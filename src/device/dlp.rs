//! The driver of a DLP machine: turns acts and layers into messages, and replies into events. No I/O and no clock.
//!
//! The owner hands the driver acts and encoded layers, sends what [`DlpDriver::next_message`] gives while the session has room,
//! and feeds what the device says to [`DlpDriver::handle`]. Requests go before layer data, so that layer n is exposed while
//! layer n + 1 travels. Replies are paired with requests by number; news never counts as an answer.
//!
//! Which layer goes into which slot, and whether a refused one is sent again, is the owner's to decide: the job engine's. A
//! driver lives as long as one session; after a reconnect the owner builds a new one, and what was under way is void.

use std::collections::VecDeque;

use super::{Act, Outcome};
use crate::link::message::{
    DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, Refusal, Reply, Report, Request,
};

/// What came of what the driver was given.
#[derive(Clone, Debug, PartialEq)]
pub enum DriverEvent {
    /// The device holds the layer, decoded and checked.
    Uploaded {
        /// Which layer.
        layer: u32,
    },
    /// The device does not take the layer.
    UploadRefused {
        /// Which layer.
        layer: u32,
        /// The device's reason.
        refusal: Refusal,
    },
    /// The act under way has ended.
    ActDone(Outcome),
    /// The state that was asked for.
    StateKnown(DeviceState),
    /// Something keeps the device from working, or it works again (`None`).
    Fault(Option<Fault>),
    /// A reply to no request, or of another kind than its request: the device does not follow the protocol.
    Confused {
        /// The number it bears.
        number: u32,
    },
}

/// Why something cannot be asked of the device now: a mistake of the owner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DriverBusy {
    /// Acts are done one at a time.
    #[error("the machine is still busy with the last act")]
    ActUnderWay,
    /// Layers are sent one at a time.
    #[error("the last layer is still on its way")]
    UploadUnderWay,
}

/// One session's driver.
#[derive(Debug)]
pub struct DlpDriver {
    job: u64,
    last_number: u32,
    /// Requests not yet sent: one act, one question and one upload's beginning at most.
    requests: VecDeque<(u32, Request)>,
    /// The act whose reply is due.
    act: Option<(u32, Act)>,
    /// The question whose reply is due.
    query: Option<u32>,
    /// The layer on its way.
    upload: Option<Upload>,
}

#[derive(Debug)]
struct Upload {
    number: u32,
    layer: u32,
    /// Empty once all is sent: from then on the line alone keeps what the device has not acknowledged.
    bytes: Vec<u8>,
    sent_bytes: usize,
}

impl DlpDriver {
    /// A driver for a job (its key in [`ExposureId`]) on a device that just said its welcome.
    pub fn new(job: u64) -> Self {
        Self { job, last_number: 0, requests: VecDeque::new(), act: None, query: None, upload: None }
    }

    /// Whether an act's end is still to come.
    pub fn is_acting(&self) -> bool {
        self.act.is_some()
    }

    /// Begins an act; its end comes as [`DriverEvent::ActDone`].
    ///
    /// # Errors
    /// [`DriverBusy::ActUnderWay`].
    pub fn act(&mut self, act: Act) -> Result<(), DriverBusy> {
        if self.act.is_some() {
            return Err(DriverBusy::ActUnderWay);
        }
        let number = self.request(match act {
            Act::Home => Request::Home,
            Act::Move { position_um, speed_um_s } => Request::Move { position_um, speed_um_s },
            Act::Expose { layer, duration_ms, light_pwm } => {
                Request::Expose { id: self.id(layer), duration_ms, light_pwm }
            }
        });
        self.act = Some((number, act));
        Ok(())
    }

    /// Asks for the device's state; it comes as [`DriverEvent::StateKnown`]. A question still open is not asked twice.
    pub fn query_state(&mut self) {
        if self.query.is_none() {
            self.query = Some(self.request(Request::State));
        }
    }

    /// Begins to send a layer into a slot; its end comes as [`DriverEvent::Uploaded`] or [`DriverEvent::UploadRefused`].
    /// `crc32` is that of the decoded rows ([`super::encoding::picture_crc32`]).
    ///
    /// # Errors
    /// [`DriverBusy::UploadUnderWay`].
    pub fn upload(
        &mut self,
        layer: u32,
        slot: u8,
        encoding: Encoding,
        bytes: Vec<u8>,
        crc32: u32,
    ) -> Result<(), DriverBusy> {
        if self.upload.is_some() {
            return Err(DriverBusy::UploadUnderWay);
        }
        let number = self.request(Request::LayerBegin {
            slot,
            id: self.id(layer),
            encoding,
            encoded_bytes: bytes.len() as u32,
            decoded_crc32: crc32,
        });
        self.upload = Some(Upload { number, layer, bytes, sent_bytes: 0 });
        Ok(())
    }

    /// The next message to send, requests first. Call it only while the session can take a request; layer data comes in pieces
    /// of at most `room_bytes`, and not at all where that is 0.
    pub fn next_message(&mut self, room_bytes: usize) -> Option<HostMessage> {
        if let Some((number, request)) = self.requests.pop_front() {
            return Some(HostMessage::Request { number, request });
        }
        self.upload.as_mut()?.next_piece(room_bytes).map(HostMessage::LayerData)
    }

    /// Takes what the device says.
    pub fn handle(&mut self, message: DeviceMessage) -> DriverEvent {
        let (number, reply) = match message {
            DeviceMessage::Report(Report::Fault(fault)) => return DriverEvent::Fault(fault),
            DeviceMessage::Reply { number, reply } => (number, reply),
        };
        if let Some((_, act)) = self.act.filter(|(due, _)| *due == number) {
            return self.act_replied(number, act, &reply);
        }
        if self.query == Some(number)
            && let Reply::State(state) = reply
        {
            self.query = None;
            return DriverEvent::StateKnown(state);
        }
        match self.upload.take_if(|upload| upload.number == number && upload.is_ended_by(&reply)) {
            Some(Upload { layer, .. }) => match reply {
                Reply::Refused(refusal) => DriverEvent::UploadRefused { layer, refusal },
                _ => DriverEvent::Uploaded { layer },
            },
            None => DriverEvent::Confused { number },
        }
    }

    fn act_replied(&mut self, number: u32, act: Act, reply: &Reply) -> DriverEvent {
        let outcome = match (act, reply) {
            (Act::Home | Act::Move { .. }, Reply::Moved { position_um }) => {
                Outcome::Arrived { position_um: *position_um }
            }
            (Act::Expose { layer, .. }, Reply::Exposed { id, duration_ms }) if *id == self.id(layer) => {
                Outcome::Exposed { layer, duration_ms: *duration_ms }
            }
            (_, Reply::Refused(refusal)) => Outcome::Refused(*refusal),
            _ => return DriverEvent::Confused { number },
        };
        self.act = None;
        DriverEvent::ActDone(outcome)
    }

    fn id(&self, layer: u32) -> ExposureId {
        ExposureId { job: self.job, layer }
    }

    /// Queues a request; its number, which the reply bears.
    fn request(&mut self, request: Request) -> u32 {
        self.last_number = self.last_number.wrapping_add(1);
        self.requests.push_back((self.last_number, request));
        self.last_number
    }
}

impl Upload {
    /// The next piece of the layer; `None` where all is sent or there is no room.
    fn next_piece(&mut self, room_bytes: usize) -> Option<Vec<u8>> {
        let rest = &self.bytes[self.sent_bytes..];
        let piece = rest[..rest.len().min(room_bytes)].to_vec();
        self.sent_bytes += piece.len();
        if self.sent_bytes == self.bytes.len() {
            (self.bytes, self.sent_bytes) = (Vec::new(), 0);
        }
        (!piece.is_empty()).then_some(piece)
    }

    /// A device may refuse a layer halfway, but take it only whole.
    fn is_ended_by(&self, reply: &Reply) -> bool {
        match reply {
            Reply::Done => self.bytes.is_empty(),
            reply => matches!(reply, Reply::Refused(_)),
        }
    }
}
