//! What host and device say to each other once frames arrive whole and in order. `docs/protocol.md` is the contract.
//!
//! Every [`Request`] has a number that its [`Reply`] repeats; a [`Report`] answers nothing. Core and alloc only: firmware
//! can share this file.

extern crate alloc;

use alloc::string::String;
use alloc::vec::Vec;

/// Names an exposure for ever: the job's key (random, chosen by the host when the job is accepted) and the layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ExposureId {
    /// Key of the job, never 0.
    pub job: u64,
    /// Layer number, from 0.
    pub layer: u32,
}

/// Kind of machine at the other end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum DeviceKind {
    /// Resin, a projector or masked panel.
    Dlp = 1,
    /// Metal powder, a laser.
    Slm = 2,
}

/// How a layer's pixels are written in its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Encoding {
    /// 1 bit a pixel, rows padded to bytes, first pixel in the highest bit, 1 lit.
    RawBit = 0,
    /// CCITT Group 4 of the same picture (ITU-T T.6), lit written as black.
    Group4 = 1,
    /// 8 bits a pixel.
    RawGrey = 2,
    /// 8 bits a pixel, runs.
    RunGrey = 3,
}

/// What the device is and can do; fixed from its start to its next reset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Capabilities {
    /// Kind of machine.
    pub kind: DeviceKind,
    /// Model and firmware, for people; at most 64 bytes of UTF-8.
    pub name: String,
    /// Pixels a row.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixel pitch, nanometres.
    pub pixel_nm: [u32; 2],
    /// Layers the device can hold, at least 2.
    pub layer_slots: u8,
    /// Bytes its receive buffer takes: the most unacknowledged bytes in flight.
    pub window_bytes: u32,
    /// Largest frame on the wire, its delimiter included, bytes.
    pub largest_frame_bytes: u16,
    /// What it decodes.
    pub encodings: Vec<Encoding>,
    /// Longest exposure it allows, milliseconds.
    pub max_exposure_ms: u32,
    /// Highest plate position above the bottom of the vat, micrometres.
    pub max_position_um: i32,
}

/// What the device is doing; sent with the welcome and on request.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceState {
    /// Drawn anew at each start of the device: tells a reset from a lost line.
    pub boot_id: u32,
    /// The last exposure that ran its whole time. Kept across resets where the device can.
    pub last_exposed: Option<ExposureId>,
    /// The exposure running now.
    pub exposing: Option<ExposureId>,
    /// An exposure that began and was ended early (reset, abort, interlock), and for how long there was light.
    pub cut_short: Option<(ExposureId, u32)>,
    /// Whether there is light.
    pub light_on: bool,
    /// Plate height above the bottom of the vat, micrometres; `None` before homing.
    pub position_um: Option<i32>,
    /// Whether the plate moves.
    pub moving: bool,
    /// For each slot the layer it holds, complete and checked.
    pub slots: Vec<Option<ExposureId>>,
    /// What keeps it from working.
    pub fault: Option<Fault>,
}

/// From host to device, in order, none lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HostMessage {
    /// Something to do, answered by one [`Reply`] of the same number.
    Request {
        /// Number, ascending, from 1 in each session.
        number: u32,
        /// What.
        request: Request,
    },
    /// The next bytes of the layer begun last.
    LayerData(Vec<u8>),
}

/// What a DLP machine is asked to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Tell the state. Answered by [`Reply::State`].
    State,
    /// A layer follows in [`HostMessage::LayerData`]. Answered by [`Reply::Done`] once all bytes are there, decoded and the
    /// CRC found right; the slot then holds the layer.
    LayerBegin {
        /// Slot to fill; what it held is forgotten.
        slot: u8,
        /// The layer.
        id: ExposureId,
        /// How it is written.
        encoding: Encoding,
        /// Bytes that follow.
        encoded_bytes: u32,
        /// CRC-32 (IEEE) of the decoded raw rows.
        decoded_crc32: u32,
    },
    /// Shine the layer. Answered by [`Reply::Exposed`] when the light is off again.
    Expose {
        /// The layer; must be in a slot, which becomes free.
        id: ExposureId,
        /// Time with light, milliseconds.
        duration_ms: u32,
        /// Light power, 1 to 255.
        light_pwm: u8,
    },
    /// Find the zero position, plate at the bottom of the vat. Answered by [`Reply::Moved`].
    Home,
    /// Move the plate. Answered by [`Reply::Moved`] on arrival.
    Move {
        /// Target above the bottom of the vat, micrometres.
        position_um: i32,
        /// Speed, micrometres a second.
        speed_um_s: u32,
    },
}

/// From device to host, in order, none lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeviceMessage {
    /// The answer to a request.
    Reply {
        /// The request's number.
        number: u32,
        /// The answer.
        reply: Reply,
    },
    /// News that answers nothing.
    Report(Report),
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// Done.
    Done,
    /// The state.
    State(DeviceState),
    /// The exposure ran its whole time.
    Exposed {
        /// Which.
        id: ExposureId,
        /// How long the light was on, milliseconds.
        duration_ms: u32,
    },
    /// The plate arrived.
    Moved {
        /// Where it is, micrometres.
        position_um: i32,
    },
    /// Not done, and why.
    Refused(Refusal),
}

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Refusal {
    /// The device has a fault or was aborted; a new hello clears an abort.
    NotReady = 1,
    /// That layer, or a later one of its job, was exposed before.
    AlreadyExposed = 2,
    /// Longer than the device's maximum, or no time at all.
    BadDuration = 3,
    /// No slot holds that layer, or no such slot.
    NoSuchLayer = 4,
    /// The slot is being exposed.
    SlotBusy = 5,
    /// The decoded layer's CRC is not the announced one, or it did not decode.
    BadLayer = 6,
    /// Encoding not supported.
    BadEncoding = 7,
    /// Outside the travel, or at no speed.
    BadMove = 8,
    /// Not homed.
    NotHomed = 9,
    /// Busy with a request of the same kind.
    Busy = 10,
    /// Ended early by an abort, a light-off or an interlock.
    CutShort = 11,
    /// Not a request this kind of device knows.
    Unknown = 12,
}

/// Unasked news.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Report {
    /// Something keeps the device from working, or it works again (`None`).
    Fault(Option<Fault>),
}

/// What keeps a device from working.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The device's own number for it.
    pub code: u16,
    /// For people; at most 120 bytes of UTF-8.
    pub text: String,
}

/// Overtakes everything; acknowledged at once by the same number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Urgent {
    /// Light off, stop moving, forget the layers; nothing more until a new hello.
    Abort = 1,
    /// Light off now; a running exposure is cut short.
    LightOff = 2,
    /// Begin nothing new until [`Urgent::Release`]; what runs, ends.
    Hold = 3,
    /// Begin again.
    Release = 4,
}
