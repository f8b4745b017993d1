//! Layers on their way to the device: one after the other, in pieces, and never more than its buffer has room for.
//! `tests/device_driver.rs` tests it.

use super::DriverBusy;
use crate::deadline::Deadline;
use crate::link::message::{ExposureId, Reply, Request};

/// Time limit for the reply to a layer, counted from when its last byte was handed to the line. The line holds at most half a
/// second of data.
pub(super) const LAYER_TIMEOUT_US: u64 = 10_000_000;

/// The layers that the device is to be told of, or that are not on it whole.
#[derive(Debug)]
pub(super) struct Uploads {
    /// At most two, in the order of their begin: one that streams while it is marked, and one that waits for its turn.
    queue: Vec<Upload>,
    /// `None` if the device keeps each layer in a slot of its own.
    credit: Option<Credit>,
}

/// What comes next of the layers.
pub(super) enum Piece {
    /// The request that announces a layer.
    Begin(Request),
    /// Bytes of the layer that was announced last.
    Data(Vec<u8>),
}

/// A layer that is on its way.
#[derive(Debug)]
pub(super) struct Upload {
    pub(super) id: ExposureId,
    /// Announces the layer; `None` once it is sent.
    begin: Option<Request>,
    /// Number of that request, once it is sent.
    number: Option<u32>,
    /// Empty once all is sent: the line keeps what the device has not acknowledged.
    bytes: Vec<u8>,
    sent_bytes: usize,
    /// When the reply is due; set once all is sent.
    due: Option<Deadline>,
    /// The device has said that it can begin with the layer. The rest of its bytes follows.
    is_taken: bool,
}

/// Room in the buffer that all layers share.
#[derive(Clone, Copy, Debug)]
struct Credit {
    buffer_bytes: u32,
    /// Bytes of layer data since the session began; wraps, like the device's count.
    sent_bytes: u32,
    taken_bytes: u32,
}

impl Credit {
    fn in_flight_bytes(&self) -> u32 {
        self.sent_bytes.wrapping_sub(self.taken_bytes)
    }

    fn free_bytes(&self) -> u32 {
        self.buffer_bytes.saturating_sub(self.in_flight_bytes())
    }
}

impl Uploads {
    /// No layers yet. `buffer_bytes` is the size of the buffer that all layers share, if there is one.
    pub(super) fn new(buffer_bytes: Option<u32>) -> Self {
        let credit = buffer_bytes.map(|buffer_bytes| Credit { buffer_bytes, sent_bytes: 0, taken_bytes: 0 });
        Self { queue: Vec::new(), credit }
    }

    /// Adds a layer, which `begin` announces.
    pub(super) fn add(&mut self, id: ExposureId, begin: Request, bytes: Vec<u8>) -> Result<(), DriverBusy> {
        if self.queue.len() > 1 || self.queue.iter().any(|upload| !upload.is_taken) {
            return Err(DriverBusy::UploadUnderWay);
        }
        let begin = Some(begin);
        self.queue.push(Upload { id, begin, number: None, bytes, sent_bytes: 0, due: None, is_taken: false });
        Ok(())
    }

    /// What comes next, of at most `room_bytes`; `number` is for a request. `None` if all is sent or there is no room.
    pub(super) fn next(&mut self, number: u32, room_bytes: usize, now_us: u64) -> Option<Piece> {
        let credit_bytes = self.credit.map_or(usize::MAX, |credit| credit.free_bytes() as usize);
        let upload = self.queue.iter_mut().find(|upload| !upload.is_sent())?;
        if let Some(begin) = upload.begin.take() {
            upload.number = Some(number);
            return Some(Piece::Begin(begin));
        }
        let data = upload.next_data(room_bytes.min(credit_bytes), now_us)?;
        if let Some(credit) = &mut self.credit {
            credit.sent_bytes = credit.sent_bytes.wrapping_add(data.len() as u32);
        }
        self.drop_done();
        Some(Piece::Data(data))
    }

    /// The layer whose request has this number and is not answered.
    pub(super) fn awaiting(&self, number: u32) -> Option<&Upload> {
        self.queue.iter().find(|upload| upload.number == Some(number) && !upload.is_taken)
    }

    /// Whether a device may answer a layer so now. It may refuse it at any time. It may take it before all bytes are sent only if
    /// layers share a buffer: the rest streams.
    pub(super) fn may_end(&self, upload: &Upload, reply: &Reply) -> bool {
        match reply {
            Reply::Done => self.credit.is_some() || upload.bytes.is_empty(),
            reply => matches!(reply, Reply::Refused(_)),
        }
    }

    /// The device takes the layer with this request, or refuses it.
    pub(super) fn answered(&mut self, number: u32, is_refused: bool) {
        if let Some(upload) = self.queue.iter_mut().find(|upload| upload.number == Some(number)) {
            (upload.is_taken, upload.due) = (true, None);
            if is_refused {
                upload.bytes = Vec::new();
            }
        }
        self.drop_done();
    }

    fn drop_done(&mut self) {
        self.queue.retain(|upload| !(upload.is_taken && upload.is_sent()));
    }

    /// The device reports how many bytes of layer data it has taken. Returns whether that can be true.
    pub(super) fn room(&mut self, taken_bytes: u32) -> bool {
        let Some(credit) = &mut self.credit else { return false };
        let newly_taken_bytes = taken_bytes.wrapping_sub(credit.taken_bytes);
        let is_possible = newly_taken_bytes <= credit.in_flight_bytes();
        if is_possible {
            credit.taken_bytes = taken_bytes;
        }
        is_possible
    }

    /// Whether bytes of a layer that the device has taken are still to be sent.
    pub(super) fn is_streaming(&self) -> bool {
        self.queue.iter().any(|upload| upload.is_taken)
    }

    /// When the next reply is due.
    pub(super) fn due_us(&self) -> Option<u64> {
        self.queue.iter().filter_map(|upload| upload.due).map(Deadline::at_us).min()
    }

    /// The layer whose reply is overdue.
    pub(super) fn overdue(&mut self, now_us: u64) -> Option<u32> {
        let is_overdue = |upload: &mut Upload| upload.due.as_mut().is_some_and(|due| due.is_over(now_us));
        let upload = self.queue.iter_mut().find_map(|upload| is_overdue(upload).then_some(upload))?;
        upload.due = None;
        Some(upload.id.layer)
    }
}

impl Upload {
    fn is_sent(&self) -> bool {
        self.begin.is_none() && self.bytes.is_empty()
    }

    fn next_data(&mut self, room_bytes: usize, now_us: u64) -> Option<Vec<u8>> {
        let rest = &self.bytes[self.sent_bytes..];
        let data = rest[..rest.len().min(room_bytes)].to_vec();
        self.sent_bytes += data.len();
        if self.sent_bytes == self.bytes.len() {
            (self.bytes, self.sent_bytes) = (Vec::new(), 0);
            self.due = (!self.is_taken).then(|| Deadline::at(now_us + LAYER_TIMEOUT_US));
        }
        (!data.is_empty()).then_some(data)
    }
}
