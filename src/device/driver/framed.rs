//! The driver of machines that speak the framed protocol: turns acts and layers into messages, and replies into events. It does no
//! I/O and reads no clock.
//!
//! The owner passes acts and encoded layers to the driver, sends the messages of [`FramedDriver::next_message`] while the session
//! has room, and passes received messages to [`FramedDriver::handle`]. Requests go before layer data, so that layer n is exposed
//! while layer n + 1 is sent. Replies are matched to requests by number; a report is never an answer.
//!
//! The job engine decides which layer goes into which slot and whether a refused layer is sent again. A driver lasts for one
//! session. After a reconnect the owner builds a new one, and everything under way is void. `tests/device_common/print.rs` prints
//! with it.

use std::collections::VecDeque;

use super::upload::{LAYER_TIMEOUT_US, Piece, Uploads};
use crate::deadline::Deadline;
use crate::device::{Act, Outcome, PowderAct, PowderOutcome, VatAct, VatOutcome};
use crate::link::message::{
    DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, MachineCapabilities, PowderReply,
    PowderRequest, Refusal, Reply, Report, Request, VatReply, VatRequest,
};
use crate::text::mm_text;

/// Time limit for the reply to a State request. It holds while the device decodes a layer or moves, too.
const STATE_TIMEOUT_US: u64 = 5_000_000;
/// State requests without a reply. One is sent twice a second and one after each act. A device that leaves this many open is
/// silent; no more are sent until the oldest times out.
const MAX_QUESTIONS: usize = 4;

/// What the driver reports to its owner.
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
    StateKnown {
        /// The state.
        state: DeviceState,
        /// The act under way has reached the device: this request was sent after it.
        act_taken: bool,
    },
    /// The device has a fault, or its fault is gone (`None`).
    Fault(Option<Fault>),
    /// The device does not follow the protocol: a request got no reply in time, or a reply makes no sense. The text says which.
    /// The owner must end the session.
    Misbehaved(String),
}

/// The owner gave the driver more than it takes: an error of the owner.
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
pub struct FramedDriver {
    job: u64,
    last_number: u32,
    /// Requests not yet sent: at most one act and [`MAX_QUESTIONS`] State requests.
    requests: VecDeque<(u32, Request)>,
    /// The act whose reply is due.
    act: Option<(u32, Act)>,
    /// The State requests whose replies are due, at most [`MAX_QUESTIONS`].
    questions: VecDeque<(u32, Deadline)>,
    uploads: Uploads,
}

impl FramedDriver {
    /// A driver for a job (its key in [`ExposureId`]) in a session that just began with a machine like this.
    pub fn new(job: u64, machine: &MachineCapabilities) -> Self {
        let buffer_bytes = match machine {
            MachineCapabilities::Vat(_) => None,
            MachineCapabilities::Powder(powder) => Some(powder.buffer_bytes),
        };
        let (requests, questions) = (VecDeque::new(), VecDeque::new());
        Self { job, last_number: 0, requests, act: None, questions, uploads: Uploads::new(buffer_bytes) }
    }

    /// Whether an act is under way.
    pub fn is_acting(&self) -> bool {
        self.act.is_some()
    }

    /// Whether a message of [`Self::next_message`] is the request of the act under way. When the owner hands it to the line, the
    /// act's least time begins.
    pub fn is_act(&self, message: &HostMessage) -> bool {
        match (message, self.act) {
            (HostMessage::Request { number, .. }, Some((act, _))) => *number == act,
            _ => false,
        }
    }

    /// Begins an act. Its end is reported as [`DriverEvent::ActDone`]. A State request follows it, whose reply shows that the device
    /// has received the act. The owner limits the time that an act may take.
    ///
    /// # Errors
    /// [`DriverBusy::ActUnderWay`].
    pub fn act(&mut self, act: Act, now_us: u64) -> Result<(), DriverBusy> {
        if self.act.is_some() {
            return Err(DriverBusy::ActUnderWay);
        }
        let number = self.request(match act {
            Act::Vat(act) => Request::Vat(self.vat_request(act)),
            Act::Powder(act) => Request::Powder(self.powder_request(act)),
        });
        self.act = Some((number, act));
        self.ask(now_us);
        Ok(())
    }

    fn vat_request(&self, act: VatAct) -> VatRequest {
        match act {
            VatAct::Home => VatRequest::Home,
            VatAct::Move { position_um, speed_um_s } => VatRequest::Move { position_um, speed_um_s },
            VatAct::Change { vat, wash_ms, drain_ms } => VatRequest::Change { vat, wash_ms, drain_ms },
            VatAct::Expose { layer, pass, duration_ms, light_pwm } => {
                VatRequest::Expose { id: self.id(layer, pass), duration_ms, light_pwm }
            }
        }
    }

    fn powder_request(&self, act: PowderAct) -> PowderRequest {
        match act {
            PowderAct::Home => PowderRequest::Home,
            PowderAct::Move { position_um, speed_um_s } => PowderRequest::Move { position_um, speed_um_s },
            PowderAct::Recoat => PowderRequest::Recoat,
            PowderAct::Mark { layer, from_vector, most_ms } => {
                PowderRequest::Mark { id: self.id(layer, 0), from_vector, most_ms }
            }
        }
    }

    /// Takes back an exposure that has not left the host, so that it does not begin after a light-off. `is_unsent` says that the
    /// owner still holds its message. Returns whether an exposure was taken back; its end is not reported then.
    pub fn take_back_exposure(&mut self, is_unsent: bool) -> bool {
        let Some((number, _)) = self.act.filter(|(_, act)| act.is_exposure()) else { return false };
        let queued = self.requests.iter().position(|(queued, _)| *queued == number);
        if let Some(place) = queued {
            self.requests.remove(place);
        }
        if !is_unsent && queued.is_none() {
            return false;
        }
        self.act = None;
        true
    }

    /// Asks for the device's state, reported as [`DriverEvent::StateKnown`]. Does nothing if a State request is open.
    pub fn query_state(&mut self, now_us: u64) {
        if self.questions.is_empty() {
            self.ask(now_us);
        }
    }

    fn ask(&mut self, now_us: u64) {
        if self.questions.len() < MAX_QUESTIONS {
            let number = self.request(Request::State);
            self.questions.push_back((number, Deadline::at(now_us + STATE_TIMEOUT_US)));
        }
    }

    /// Begins to send a layer into a slot. The end is reported as [`DriverEvent::Uploaded`] or [`DriverEvent::UploadRefused`]. A layer
    /// larger than the buffer that all layers share is reported as uploaded when it can be begun; the rest follows while it is marked,
    /// and the next layer after that. `crc32` is that of the decoded layer ([`crate::pipeline::EncodedLayer`]).
    ///
    /// # Errors
    /// [`DriverBusy::UploadUnderWay`].
    pub fn upload(
        &mut self,
        layer: u32,
        pass: u8,
        slot: u8,
        encoding: Encoding,
        bytes: Vec<u8>,
        crc32: u32,
    ) -> Result<(), DriverBusy> {
        let id = self.id(layer, pass);
        let encoded_bytes = bytes.len() as u32;
        let begin = Request::LayerBegin { slot, id, encoding, encoded_bytes, decoded_crc32: crc32 };
        self.uploads.add(id, begin, bytes)
    }

    /// Whether bytes of a layer that was reported as uploaded are still to be sent.
    pub fn is_streaming(&self) -> bool {
        self.uploads.is_streaming()
    }

    /// The next message to send, requests first. Call it only while the session can take a request. Layer data comes in pieces of
    /// at most `room_bytes`; if that is 0, none comes.
    pub fn next_message(&mut self, room_bytes: usize, now_us: u64) -> Option<HostMessage> {
        if let Some((number, request)) = self.requests.pop_front() {
            return Some(HostMessage::Request { number, request });
        }
        let number = self.last_number.wrapping_add(1);
        Some(match self.uploads.next(number, room_bytes, now_us)? {
            Piece::Begin(request) => {
                self.last_number = number;
                HostMessage::Request { number, request }
            }
            Piece::Data(bytes) => HostMessage::LayerData(bytes),
        })
    }

    /// When to call [`Self::handle_timeout`]; `None` while the driver waits for no reply.
    pub fn next_timeout_us(&self) -> Option<u64> {
        let question = self.questions.front().map(|(_, due)| due.at_us());
        question.into_iter().chain(self.uploads.due_us()).min()
    }

    /// Reports a reply that is overdue.
    pub fn handle_timeout(&mut self, now_us: u64) -> Option<DriverEvent> {
        if let Some((_, due)) = self.questions.front_mut()
            && due.is_over(now_us)
        {
            self.questions.clear();
            let seconds = STATE_TIMEOUT_US / 1_000_000;
            return Some(DriverEvent::Misbehaved(format!(
                "the device did not answer a question for its state within {seconds} s: check the line and its firmware"
            )));
        }
        let (layer, seconds) = (self.uploads.overdue(now_us)?, LAYER_TIMEOUT_US / 1_000_000);
        Some(DriverEvent::Misbehaved(format!(
            "the device did not say within {seconds} s whether it holds layer {layer}: check its firmware"
        )))
    }

    /// Handles a message from the device; `None` if its owner need not know of it.
    pub fn handle(&mut self, message: DeviceMessage) -> Option<DriverEvent> {
        let (number, reply) = match message {
            DeviceMessage::Report(Report::Fault(fault)) => return Some(DriverEvent::Fault(fault)),
            DeviceMessage::Report(Report::Room { taken_bytes }) => return self.room(taken_bytes),
            DeviceMessage::Reply { number, reply } => (number, reply),
        };
        if let Some((_, act)) = self.act.filter(|(due, _)| *due == number) {
            return Some(self.act_replied(act, number, &reply));
        }
        if let Some(place) = self.questions.iter().position(|(due, _)| *due == number) {
            return Some(match reply {
                Reply::State(state) => {
                    self.questions.remove(place);
                    let act_taken = self.act.is_some_and(|(act, _)| act < number);
                    DriverEvent::StateKnown { state, act_taken }
                }
                other => nonsense("for its state", number, &other),
            });
        }
        Some(self.upload_replied(number, &reply))
    }

    fn room(&mut self, taken_bytes: u32) -> Option<DriverEvent> {
        (!self.uploads.room(taken_bytes)).then(|| {
            DriverEvent::Misbehaved(format!(
                "the device says that it took {taken_bytes} bytes of layer data, more than it was sent: check its firmware"
            ))
        })
    }

    fn upload_replied(&mut self, number: u32, reply: &Reply) -> DriverEvent {
        let Some(upload) = self.uploads.awaiting(number) else {
            return DriverEvent::Misbehaved(format!(
                "the device replied to request {number}, which awaits no reply: check its firmware"
            ));
        };
        let id = upload.id;
        if !self.uploads.may_end(upload, reply) {
            return nonsense(&format!("to take {}", exposure_text(id)), number, reply);
        }
        let layer = id.layer;
        self.uploads.answered(number, matches!(reply, Reply::Refused(_)));
        match reply {
            Reply::Refused(refusal) => DriverEvent::UploadRefused { layer, refusal: *refusal },
            _ => DriverEvent::Uploaded { layer },
        }
    }

    fn act_replied(&mut self, act: Act, number: u32, reply: &Reply) -> DriverEvent {
        let outcome = match (act, reply) {
            (_, Reply::Refused(refusal)) => Some(Outcome::Refused(*refusal)),
            (Act::Vat(act), Reply::Vat(reply)) => self.vat_outcome(act, *reply).map(Outcome::Vat),
            (Act::Powder(act), Reply::Powder(reply)) => self.powder_outcome(act, *reply).map(Outcome::Powder),
            _ => None,
        };
        let Some(outcome) = outcome else { return nonsense(&self.act_text(act), number, reply) };
        self.act = None;
        DriverEvent::ActDone(outcome)
    }

    fn vat_outcome(&self, act: VatAct, reply: VatReply) -> Option<VatOutcome> {
        match (act, reply) {
            (VatAct::Home | VatAct::Move { .. }, VatReply::Moved { position_um }) => {
                Some(VatOutcome::Arrived { position_um })
            }
            (VatAct::Change { vat, .. }, VatReply::Changed { vat: told }) if told == vat => {
                Some(VatOutcome::Changed { vat })
            }
            (VatAct::Expose { layer, pass, .. }, VatReply::Exposed { id, duration_ms })
                if id == self.id(layer, pass) =>
            {
                Some(VatOutcome::Exposed { layer, pass, duration_ms })
            }
            _ => None,
        }
    }

    fn powder_outcome(&self, act: PowderAct, reply: PowderReply) -> Option<PowderOutcome> {
        match (act, reply) {
            (PowderAct::Home | PowderAct::Move { .. }, PowderReply::Moved { position_um }) => {
                Some(PowderOutcome::Arrived { position_um })
            }
            (PowderAct::Recoat, PowderReply::Recoated) => Some(PowderOutcome::Recoated),
            (PowderAct::Mark { layer, .. }, PowderReply::Marked { id, vectors, laser_ms, starved_ms })
                if id == self.id(layer, 0) =>
            {
                Some(PowderOutcome::Marked { layer, vectors, laser_ms, starved_ms })
            }
            _ => None,
        }
    }

    /// What an act asks of the device.
    fn act_text(&self, act: Act) -> String {
        match act {
            Act::Vat(VatAct::Home) | Act::Powder(PowderAct::Home) => "to home".into(),
            Act::Vat(VatAct::Move { position_um, .. }) | Act::Powder(PowderAct::Move { position_um, .. }) => {
                format!("to move to {}", mm_text(position_um))
            }
            Act::Vat(VatAct::Expose { layer, pass, duration_ms, .. }) => {
                format!("to expose {} for {duration_ms} ms", exposure_text(self.id(layer, pass)))
            }
            Act::Vat(VatAct::Change { vat, .. }) => format!("to put vat {vat} in place"),
            Act::Powder(PowderAct::Recoat) => "to recoat".into(),
            Act::Powder(PowderAct::Mark { layer, from_vector, .. }) => {
                format!("to mark {} from vector {from_vector} on", exposure_text(self.id(layer, 0)))
            }
        }
    }

    fn id(&self, layer: u32, pass: u8) -> ExposureId {
        ExposureId { job: self.job, layer, pass }
    }

    /// Queues a request and returns its number, which the reply repeats.
    fn request(&mut self, request: Request) -> u32 {
        self.last_number = self.last_number.wrapping_add(1);
        self.requests.push_back((self.last_number, request));
        self.last_number
    }
}

fn exposure_text(ExposureId { job, layer, pass }: ExposureId) -> String {
    format!("layer {layer}, pass {pass}, of job {job:016x}")
}

/// A reply that does not belong to the request of this number, which asked the device for what `asked` says.
fn nonsense(asked: &str, number: u32, reply: &Reply) -> DriverEvent {
    let reply = match reply {
        Reply::Done => "\"done\"".into(),
        Reply::State(_) => "a state".into(),
        Reply::Vat(VatReply::Exposed { id, duration_ms }) => {
            format!("an exposure of {duration_ms} ms of {}", exposure_text(*id))
        }
        Reply::Vat(VatReply::Moved { position_um }) | Reply::Powder(PowderReply::Moved { position_um }) => {
            format!("a move to {}", mm_text(*position_um))
        }
        Reply::Vat(VatReply::Changed { vat }) => format!("a change to vat {vat}"),
        Reply::Powder(PowderReply::Recoated) => "\"recoated\"".into(),
        Reply::Powder(PowderReply::Marked { id, laser_ms, .. }) => {
            format!("{laser_ms} ms of laser for {}", exposure_text(*id))
        }
        Reply::Refused(refusal) => format!("a refusal (reason {})", *refusal as u8),
    };
    DriverEvent::Misbehaved(format!(
        "the device was asked {asked} (request {number}) and replied with {reply}: check its firmware"
    ))
}
