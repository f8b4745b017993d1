//! The driver of a DLP machine: turns acts and layers into messages, and replies into events. No I/O and no clock.
//!
//! The owner hands the driver acts and encoded layers, sends what [`DlpDriver::next_message`] gives while the session has room,
//! and feeds what the device says to [`DlpDriver::handle`]. Requests go before layer data, so that layer n is exposed while
//! layer n + 1 travels. Replies are paired with requests by number; news never counts as an answer.
//!
//! A driver lives as long as one session. After a reconnect the owner builds a new one from the state in the welcome: layers
//! still in the device's slots need not be sent again. If an exposure was running, its reply is lost with the old session: the
//! owner asks for the state ([`DlpDriver::query_state`]) until `exposing` is `None` and then looks at `last_exposed`.

use std::collections::VecDeque;

use super::{Act, Outcome};
use crate::config::Machine;
use crate::link::message::{
    Capabilities, DeviceKind, DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, Refusal, Reply,
    Report, Request,
};

/// A layer the device finds damaged is sent again at most this often. The line itself already repeats damaged frames, so a
/// second failure is no accident of the line.
const MOST_UPLOAD_ATTEMPTS: u32 = 3;

/// What came of what the driver was given.
#[derive(Clone, Debug, PartialEq)]
pub enum DriverEvent {
    /// The device holds the layer, decoded and checked; the buffer comes back to be used again.
    Uploaded {
        /// Which layer.
        layer: u32,
        /// The bytes given to [`DlpDriver::upload`].
        buffer: Vec<u8>,
    },
    /// The device does not take the layer, and sending it again did not or would not help.
    UploadFailed {
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

/// Why something cannot be asked of the device now: a mistake of the owner, or a slot that is not free yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DriverBusy {
    /// Acts are done one at a time.
    #[error("the machine is still busy with the last act")]
    ActUnderWay,
    /// All slots hold layers.
    #[error("no layer slot of the device is free")]
    NoFreeSlot,
}

/// One session's driver.
#[derive(Debug)]
pub struct DlpDriver {
    job: u64,
    last_number: u32,
    slots: Vec<Slot>,
    /// Requests not yet sent: one act and one question at most.
    requests: VecDeque<(u32, Request)>,
    /// The act whose reply is due.
    act: Option<(u32, Act)>,
    /// The question whose reply is due.
    query: Option<u32>,
    /// Layers on their way, at most one for each slot, oldest first.
    uploads: VecDeque<Upload>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slot {
    Free,
    Filling,
    Holds(u32),
    /// Until the exposure's reply; of another job where it is `None`.
    Exposing(Option<u32>),
}

#[derive(Debug)]
struct Upload {
    layer: u32,
    slot: usize,
    encoding: Encoding,
    bytes: Vec<u8>,
    crc32: u32,
    attempts: u32,
    progress: Progress,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    Waiting,
    Sending { number: u32, sent_bytes: usize },
    Sent { number: u32 },
}

impl DlpDriver {
    /// A driver for a job (its key in [`ExposureId`]) on a device that said this of itself in its welcome.
    pub fn new(job: u64, capabilities: &Capabilities, state: &DeviceState) -> Self {
        let mut driver = Self {
            job,
            last_number: 0,
            slots: vec![Slot::Free; usize::from(capabilities.layer_slots)],
            requests: VecDeque::new(),
            act: None,
            query: None,
            uploads: VecDeque::new(),
        };
        driver.learn_slots(state);
        driver
    }

    /// Layers that can be uploaded now.
    pub fn free_slots(&self) -> usize {
        self.slots.iter().filter(|slot| **slot == Slot::Free).count()
    }

    /// Whether the device holds a layer, ready to be exposed.
    pub fn holds(&self, layer: u32) -> bool {
        self.slots.contains(&Slot::Holds(layer))
    }

    /// Whether a layer is on its way.
    pub fn is_uploading(&self, layer: u32) -> bool {
        self.uploads.iter().any(|upload| upload.layer == layer)
    }

    /// Gives up a layer the device holds: its slot is free. For what is left of an earlier session and not wanted any more.
    pub fn forget(&mut self, layer: u32) {
        if let Some(slot) = self.slots.iter_mut().find(|slot| **slot == Slot::Holds(layer)) {
            *slot = Slot::Free;
        }
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
        let request = match act {
            Act::Home => Request::Home,
            Act::Move { position_um, speed_um_s } => Request::Move { position_um, speed_um_s },
            Act::Expose { layer, duration_ms, light_pwm } => {
                if let Some(slot) = self.slots.iter_mut().find(|slot| **slot == Slot::Holds(layer)) {
                    *slot = Slot::Exposing(Some(layer));
                }
                Request::Expose { id: self.id(layer), duration_ms, light_pwm }
            }
        };
        let number = self.number();
        self.requests.push_back((number, request));
        self.act = Some((number, act));
        Ok(())
    }

    /// Asks for the device's state; it comes as [`DriverEvent::StateKnown`]. A question still open is not asked twice.
    pub fn query_state(&mut self) {
        if self.query.is_none() {
            let number = self.number();
            self.requests.push_back((number, Request::State));
            self.query = Some(number);
        }
    }

    /// Queues a layer for the next free slot. `crc32` is that of the decoded rows ([`super::encoding::picture_crc32`]).
    ///
    /// # Errors
    /// [`DriverBusy::NoFreeSlot`].
    pub fn upload(&mut self, layer: u32, encoding: Encoding, bytes: Vec<u8>, crc32: u32) -> Result<(), DriverBusy> {
        let slot = self.slots.iter().position(|slot| *slot == Slot::Free).ok_or(DriverBusy::NoFreeSlot)?;
        self.slots[slot] = Slot::Filling;
        self.uploads.push_back(Upload {
            layer,
            slot,
            encoding,
            bytes,
            crc32,
            attempts: 1,
            progress: Progress::Waiting,
        });
        Ok(())
    }

    /// The next message to send, requests first. Call it only while the session can take a request; layer data comes in pieces
    /// of at most `room_bytes`, and not at all where that is 0.
    pub fn next_message(&mut self, room_bytes: usize) -> Option<HostMessage> {
        if let Some((number, request)) = self.requests.pop_front() {
            return Some(HostMessage::Request { number, request });
        }
        let sending = self.uploads.iter_mut().find(|upload| matches!(upload.progress, Progress::Sending { .. }));
        match sending {
            Some(upload) => upload.next_piece(room_bytes).map(HostMessage::LayerData),
            None => self.begin_upload(),
        }
    }

    fn begin_upload(&mut self) -> Option<HostMessage> {
        let index = self.uploads.iter().position(|upload| upload.progress == Progress::Waiting)?;
        let number = self.number();
        let id = self.id(self.uploads[index].layer);
        let upload = &mut self.uploads[index];
        upload.progress = Progress::Sending { number, sent_bytes: 0 };
        let request = Request::LayerBegin {
            slot: upload.slot as u8,
            id,
            encoding: upload.encoding,
            encoded_bytes: upload.bytes.len() as u32,
            decoded_crc32: upload.crc32,
        };
        Some(HostMessage::Request { number, request })
    }

    /// Takes what the device says.
    pub fn handle(&mut self, message: DeviceMessage) -> Option<DriverEvent> {
        let (number, reply) = match message {
            DeviceMessage::Report(Report::Fault(fault)) => return Some(DriverEvent::Fault(fault)),
            DeviceMessage::Reply { number, reply } => (number, reply),
        };
        if let Some((_, act)) = self.act.filter(|(due, _)| *due == number) {
            return Some(self.act_replied(number, act, &reply));
        }
        if self.query == Some(number)
            && let Reply::State(state) = reply
        {
            self.query = None;
            self.learn_slots(&state);
            return Some(DriverEvent::StateKnown(state));
        }
        match self.uploads.iter().position(|upload| upload.number() == Some(number)) {
            Some(index) => self.upload_replied(index, number, &reply),
            None => Some(DriverEvent::Confused { number }),
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
        if let Act::Expose { layer, .. } = act
            && let Some(slot) = self.slots.iter_mut().find(|slot| **slot == Slot::Exposing(Some(layer)))
        {
            *slot = match outcome {
                // Nothing was begun, and the layer is still there.
                Outcome::Refused(Refusal::NotReady | Refusal::Busy | Refusal::BadDuration) => Slot::Holds(layer),
                _ => Slot::Free,
            };
        }
        DriverEvent::ActDone(outcome)
    }

    fn upload_replied(&mut self, index: usize, number: u32, reply: &Reply) -> Option<DriverEvent> {
        let upload = &mut self.uploads[index];
        match reply {
            Reply::Done if upload.progress == (Progress::Sent { number }) => {
                let upload = self.uploads.remove(index)?;
                self.slots[upload.slot] = Slot::Holds(upload.layer);
                Some(DriverEvent::Uploaded { layer: upload.layer, buffer: upload.bytes })
            }
            Reply::Refused(Refusal::BadLayer) if upload.attempts < MOST_UPLOAD_ATTEMPTS => {
                upload.attempts += 1;
                upload.progress = Progress::Waiting;
                None
            }
            Reply::Refused(refusal) => {
                let upload = self.uploads.remove(index)?;
                self.slots[upload.slot] = Slot::Free;
                Some(DriverEvent::UploadFailed { layer: upload.layer, refusal: *refusal })
            }
            _ => Some(DriverEvent::Confused { number }),
        }
    }

    /// Takes over what the device says of its slots, but for those on their way.
    fn learn_slots(&mut self, state: &DeviceState) {
        for (index, slot) in self.slots.iter_mut().enumerate().filter(|(_, slot)| **slot != Slot::Filling) {
            let held = state.slots.get(index).copied().flatten();
            let own = held.filter(|id| id.job == self.job).map(|id| id.layer);
            *slot = match own {
                _ if held.is_some() && held == state.exposing => Slot::Exposing(own),
                // An exposure still on its way to the device.
                Some(layer) if *slot == Slot::Exposing(Some(layer)) && self.act.is_some() => {
                    Slot::Exposing(Some(layer))
                }
                Some(layer) => Slot::Holds(layer),
                None => Slot::Free,
            };
        }
    }

    fn id(&self, layer: u32) -> ExposureId {
        ExposureId { job: self.job, layer }
    }

    fn number(&mut self) -> u32 {
        self.last_number = self.last_number.wrapping_add(1);
        self.last_number
    }
}

impl Upload {
    fn number(&self) -> Option<u32> {
        match self.progress {
            Progress::Waiting => None,
            Progress::Sending { number, .. } | Progress::Sent { number } => Some(number),
        }
    }

    fn next_piece(&mut self, room_bytes: usize) -> Option<Vec<u8>> {
        let Progress::Sending { number, sent_bytes } = self.progress else { return None };
        let end = self.bytes.len().min(sent_bytes + room_bytes);
        if end == sent_bytes {
            return None;
        }
        let complete = end == self.bytes.len();
        self.progress =
            if complete { Progress::Sent { number } } else { Progress::Sending { number, sent_bytes: end } };
        Some(self.bytes[sent_bytes..end].to_vec())
    }
}

/// The device is not the machine that is configured.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "machine `{machine}` is configured with {what} {configured}, but the device `{device}` says {found}: correct the machine \
     file, or connect the right device"
)]
pub struct MachineMismatch {
    /// The machine's name.
    pub machine: String,
    /// The device's name.
    pub device: String,
    /// What differs.
    pub what: &'static str,
    /// As configured.
    pub configured: String,
    /// As the device says.
    pub found: String,
}

/// Checks that a device is the configured machine: kind, picture size and pixel pitch.
///
/// # Errors
/// [`MachineMismatch`] names the first difference, configured and found.
pub fn check_capabilities(machine: &Machine, capabilities: &Capabilities) -> Result<(), MachineMismatch> {
    let differs = |what, configured: String, found: String| {
        let (machine, device) = (machine.name.clone(), capabilities.name.clone());
        Err(MachineMismatch { machine, device, what, configured, found })
    };
    if capabilities.kind != DeviceKind::Dlp {
        return differs("kind", "dlp".into(), "slm".into());
    }
    let pixels = |[x, y]: [u32; 2]| format!("{x} × {y} pixels");
    let (wanted, found) = ([machine.width_px, machine.height_px], [capabilities.width_px, capabilities.height_px]);
    if wanted != found {
        return differs("a picture of", pixels(wanted), pixels(found));
    }
    let pitch = |[x, y]: [u32; 2]| format!("{} × {} µm", f64::from(x) / 1000.0, f64::from(y) / 1000.0);
    let wanted = machine.pixel_um.map(|um| (um * 1000.0).round() as u32);
    if wanted != capabilities.pixel_nm {
        return differs("a pixel pitch of", pitch(wanted), pitch(capabilities.pixel_nm));
    }
    Ok(())
}
