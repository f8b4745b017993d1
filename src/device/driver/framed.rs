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

use crate::deadline::Deadline;
use crate::device::{Act, Outcome, VatAct, VatOutcome};
use crate::link::message::{
    DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, Refusal, Reply, Report, Request, VatReply,
    VatRequest,
};
use crate::text::mm_text;

/// Time limit for the reply to a State request. It holds while the device decodes a layer or moves, too.
const STATE_TIMEOUT_US: u64 = 5_000_000;
/// Time limit for the reply to a layer, counted from when its last byte was handed to the line. The line holds at most half a
/// second of data.
const LAYER_TIMEOUT_US: u64 = 10_000_000;
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
    /// Requests not yet sent: at most one act, [`MAX_QUESTIONS`] State requests and one LayerBegin.
    requests: VecDeque<(u32, Request)>,
    /// The act whose reply is due.
    act: Option<(u32, Act)>,
    /// The State requests whose replies are due, at most [`MAX_QUESTIONS`].
    questions: VecDeque<(u32, Deadline)>,
    /// The layer on its way.
    upload: Option<Upload>,
}

#[derive(Debug)]
struct Upload {
    number: u32,
    layer: u32,
    /// Empty once all is sent: the line keeps what the device has not acknowledged.
    bytes: Vec<u8>,
    sent_bytes: usize,
    /// When the reply is due; set once all is sent.
    due: Option<Deadline>,
}

impl FramedDriver {
    /// A driver for a job (its key in [`ExposureId`]) in a session that just began.
    pub fn new(job: u64) -> Self {
        Self { job, last_number: 0, requests: VecDeque::new(), act: None, questions: VecDeque::new(), upload: None }
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
        let Act::Vat(vat) = act;
        let number = self.request(Request::Vat(match vat {
            VatAct::Home => VatRequest::Home,
            VatAct::Move { position_um, speed_um_s } => VatRequest::Move { position_um, speed_um_s },
            VatAct::Expose { layer, duration_ms, light_pwm } => {
                VatRequest::Expose { id: self.id(layer), duration_ms, light_pwm }
            }
        }));
        self.act = Some((number, act));
        self.ask(now_us);
        Ok(())
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

    /// Begins to send a layer into a slot. The end is reported as [`DriverEvent::Uploaded`] or [`DriverEvent::UploadRefused`].
    /// `crc32` is the CRC-32 of the decoded rows ([`crate::device::encoding::picture_crc32`]).
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
        self.upload = Some(Upload { number, layer, bytes, sent_bytes: 0, due: None });
        Ok(())
    }

    /// The next message to send, requests first. Call it only while the session can take a request. Layer data comes in pieces of
    /// at most `room_bytes`; if that is 0, none comes.
    pub fn next_message(&mut self, room_bytes: usize, now_us: u64) -> Option<HostMessage> {
        if let Some((number, request)) = self.requests.pop_front() {
            return Some(HostMessage::Request { number, request });
        }
        self.upload.as_mut()?.next_piece(room_bytes, now_us).map(HostMessage::LayerData)
    }

    /// When to call [`Self::handle_timeout`]; `None` while the driver waits for no reply.
    pub fn next_timeout_us(&self) -> Option<u64> {
        let question = self.questions.front().map(|(_, due)| due.at_us());
        let upload = self.upload.as_ref().and_then(|upload| upload.due).map(Deadline::at_us);
        question.into_iter().chain(upload).min()
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
        let upload = self.upload.as_mut()?;
        if !upload.due.as_mut()?.is_over(now_us) {
            return None;
        }
        upload.due = None;
        let (layer, seconds) = (upload.layer, LAYER_TIMEOUT_US / 1_000_000);
        Some(DriverEvent::Misbehaved(format!(
            "the device did not say within {seconds} s whether it holds layer {layer}: check its firmware"
        )))
    }

    /// Handles a message from the device.
    pub fn handle(&mut self, message: DeviceMessage) -> DriverEvent {
        let (number, reply) = match message {
            DeviceMessage::Report(Report::Fault(fault)) => return DriverEvent::Fault(fault),
            DeviceMessage::Reply { number, reply } => (number, reply),
        };
        if let Some((_, act)) = self.act.filter(|(due, _)| *due == number) {
            return self.act_replied(act, number, &reply);
        }
        if let Some(place) = self.questions.iter().position(|(due, _)| *due == number) {
            return match reply {
                Reply::State(state) => {
                    self.questions.remove(place);
                    let act_taken = self.act.is_some_and(|(act, _)| act < number);
                    DriverEvent::StateKnown { state, act_taken }
                }
                other => nonsense("for its state", number, &other),
            };
        }
        match self.upload.take_if(|upload| upload.number == number) {
            Some(upload) if upload.is_ended_by(&reply) => match reply {
                Reply::Refused(refusal) => DriverEvent::UploadRefused { layer: upload.layer, refusal },
                _ => DriverEvent::Uploaded { layer: upload.layer },
            },
            Some(upload) => nonsense(&format!("to take {}", exposure_text(self.id(upload.layer))), number, &reply),
            None => DriverEvent::Misbehaved(format!(
                "the device replied to request {number}, which awaits no reply: check its firmware"
            )),
        }
    }

    fn act_replied(&mut self, act: Act, number: u32, reply: &Reply) -> DriverEvent {
        let Act::Vat(vat) = act;
        let outcome = match (vat, reply) {
            (VatAct::Home | VatAct::Move { .. }, Reply::Vat(VatReply::Moved { position_um })) => {
                Outcome::Vat(VatOutcome::Arrived { position_um: *position_um })
            }
            (VatAct::Expose { layer, .. }, Reply::Vat(VatReply::Exposed { id, duration_ms }))
                if *id == self.id(layer) =>
            {
                Outcome::Vat(VatOutcome::Exposed { layer, duration_ms: *duration_ms })
            }
            (_, Reply::Refused(refusal)) => Outcome::Refused(*refusal),
            (vat, reply) => return nonsense(&self.act_text(vat), number, reply),
        };
        self.act = None;
        DriverEvent::ActDone(outcome)
    }

    /// What an act asks of the device.
    fn act_text(&self, act: VatAct) -> String {
        match act {
            VatAct::Home => "to home".into(),
            VatAct::Move { position_um, .. } => format!("to move to {}", mm_text(position_um)),
            VatAct::Expose { layer, duration_ms, .. } => {
                format!("to expose {} for {duration_ms} ms", exposure_text(self.id(layer)))
            }
        }
    }

    fn id(&self, layer: u32) -> ExposureId {
        ExposureId::first_pass(self.job, layer)
    }

    /// Queues a request and returns its number, which the reply repeats.
    fn request(&mut self, request: Request) -> u32 {
        self.last_number = self.last_number.wrapping_add(1);
        self.requests.push_back((self.last_number, request));
        self.last_number
    }
}

impl Upload {
    /// The next piece of the layer; `None` if all is sent or there is no room.
    fn next_piece(&mut self, room_bytes: usize, now_us: u64) -> Option<Vec<u8>> {
        let rest = &self.bytes[self.sent_bytes..];
        let piece = rest[..rest.len().min(room_bytes)].to_vec();
        self.sent_bytes += piece.len();
        if !piece.is_empty() && self.sent_bytes == self.bytes.len() {
            (self.bytes, self.sent_bytes) = (Vec::new(), 0);
            self.due = Some(Deadline::at(now_us + LAYER_TIMEOUT_US));
        }
        (!piece.is_empty()).then_some(piece)
    }

    /// A device may refuse a layer before all of it is sent, but accept it only afterwards.
    fn is_ended_by(&self, reply: &Reply) -> bool {
        match reply {
            Reply::Done => self.bytes.is_empty(),
            reply => matches!(reply, Reply::Refused(_)),
        }
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
        Reply::Vat(VatReply::Moved { position_um }) => format!("a move to {}", mm_text(*position_um)),
        Reply::Refused(refusal) => format!("a refusal (reason {})", *refusal as u8),
    };
    DriverEvent::Misbehaved(format!(
        "the device was asked {asked} (request {number}) and replied with {reply}: check its firmware"
    ))
}
