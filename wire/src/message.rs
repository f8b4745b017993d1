//! The messages between host and device, carried in data frames. `docs/protocol.md` is the contract.
//!
//! Every [`Request`] has a number, which its [`Reply`] repeats. A [`Report`] answers no request. The
//! [crate's example](crate) answers requests.

use alloc::string::String;
use alloc::vec::Vec;

use crate::encoding::{PictureEncoding, VectorEncoding};

/// Identifies an exposure for all time. Both ends compare it whole. The exposures of a job are ordered by layer, then by pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ExposureId {
    /// Key of the job: random, drawn by the host when it accepts the job, never 0.
    pub job: u64,
    /// Layer number, from 0.
    pub layer: u32,
    /// Number of the exposure within the layer, from 0.
    pub pass: u8,
}

impl ExposureId {
    /// The first exposure of a layer: pass 0. A layer of a vat machine has no other.
    pub const fn first_pass(job: u64, layer: u32) -> Self {
        Self { job, layer, pass: 0 }
    }
}

/// How a layer is encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Encoding {
    /// 1 bit a pixel, 1 for lit; rows padded to bytes, the first pixel in the highest bit.
    RawBit = 0,
    /// 1 bit a pixel, CCITT Group 4 (ITU-T T.6), lit written as black.
    Group4 = 1,
    /// 8 bits a pixel, rows as they are.
    RawGrey = 2,
    /// 8 bits a pixel, runs and edge pixels, arithmetically coded.
    RunGrey = 3,
    /// Scan vectors, as differences.
    Vectors = 0x20,
    /// Scan vectors, as differences, arithmetically coded.
    VectorsCoded = 0x21,
}

impl Encoding {
    /// All encodings, in the order of their numbers.
    pub const ALL: [Self; 6] =
        [Self::RawBit, Self::Group4, Self::RawGrey, Self::RunGrey, Self::Vectors, Self::VectorsCoded];

    /// The encoding of a picture; `None` for scan vectors.
    pub const fn picture(self) -> Option<PictureEncoding> {
        match self {
            Self::RawBit => Some(PictureEncoding::RawBit),
            Self::Group4 => Some(PictureEncoding::Group4),
            Self::RawGrey => Some(PictureEncoding::RawGrey),
            Self::RunGrey => Some(PictureEncoding::RunGrey),
            Self::Vectors | Self::VectorsCoded => None,
        }
    }

    /// The encoding of scan vectors; `None` for pictures.
    pub const fn vectors(self) -> Option<VectorEncoding> {
        match self {
            Self::RawBit | Self::Group4 | Self::RawGrey | Self::RunGrey => None,
            Self::Vectors => Some(VectorEncoding::Plain),
            Self::VectorsCoded => Some(VectorEncoding::Coded),
        }
    }
}

impl From<PictureEncoding> for Encoding {
    fn from(encoding: PictureEncoding) -> Self {
        match encoding {
            PictureEncoding::RawBit => Self::RawBit,
            PictureEncoding::Group4 => Self::Group4,
            PictureEncoding::RawGrey => Self::RawGrey,
            PictureEncoding::RunGrey => Self::RunGrey,
        }
    }
}

impl From<VectorEncoding> for Encoding {
    fn from(encoding: VectorEncoding) -> Self {
        match encoding {
            VectorEncoding::Plain => Self::Vectors,
            VectorEncoding::Coded => Self::VectorsCoded,
        }
    }
}

/// What the device is and can do. Fixed from its start to its next reset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Capabilities {
    /// Model and firmware, for people; at most 64 bytes of UTF-8.
    pub name: String,
    /// Layers the device can hold, at least 2.
    pub layer_slots: u8,
    /// Size of its receive buffer, bytes: the most unacknowledged bytes in flight.
    pub window_bytes: u32,
    /// Largest frame on the wire, its delimiter included, bytes.
    pub largest_frame_bytes: u16,
    /// Encodings that it decodes.
    pub encodings: Vec<Encoding>,
    /// Longest exposure that it allows, milliseconds.
    pub max_exposure_ms: u32,
    /// What only machines of its kind have.
    pub machine: MachineCapabilities,
}

/// What a machine is and can do, by its kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MachineCapabilities {
    /// Resin in a vat, exposed by a projector or a masked panel (DLP).
    Vat(VatCapabilities),
    /// Powder in a bed, melted by a laser (SLM).
    Powder(PowderCapabilities),
}

impl MachineCapabilities {
    /// The plate's greatest distance from the plane in which layers are exposed, micrometres: above the bottom of a vat, or below the
    /// working plane of a bed of powder.
    pub const fn max_position_um(&self) -> i32 {
        match self {
            Self::Vat(vat) => vat.max_position_um,
            Self::Powder(powder) => powder.max_position_um,
        }
    }
}

/// What a vat machine is and can do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VatCapabilities {
    /// Pixels a row.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixel pitch, x and y, nanometres.
    pub pixel_nm: [u32; 2],
    /// Highest plate position above the bottom of the vat, micrometres.
    pub max_position_um: i32,
    /// Its vats.
    pub vats: Vats,
}

/// The vats of a machine, each with a material of its own. One of them is in place at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Vats {
    /// Number of vats, at least 1. They are numbered from 1 on.
    pub count: u8,
    /// Longest time to put another vat in place, without washing and draining, milliseconds; 0 with one vat.
    pub change_ms: u32,
}

impl Vats {
    /// One vat, which is always in place.
    pub const ONE: Self = Self { count: 1, change_ms: 0 };
}

/// What a powder machine is and can do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PowderCapabilities {
    /// Size of the field that the laser reaches, x and y, micrometres.
    pub field_um: [u32; 2],
    /// Greatest power of the laser, milliwatts.
    pub max_power_mw: u32,
    /// Least and greatest layer height, micrometres.
    pub layer_height_um: [u32; 2],
    /// Deepest plate position below the working plane, micrometres.
    pub max_position_um: i32,
    /// Size of the buffer that all layers share, bytes of layer data; at least 1024. A layer may be larger. Of the bytes that the host
    /// sent in a session, at most so many may not be counted by [`Report::Room`] yet.
    pub buffer_bytes: u32,
}

/// What the device is doing. Sent with the welcome and on request.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceState {
    /// Drawn at random at each start of the device: distinguishes a reset from a lost line.
    pub boot_id: u32,
    /// The last exposure that ran its whole time. Kept across resets if the device can.
    pub last_exposed: Option<ExposureId>,
    /// The exposure running now.
    pub exposing: Option<ExposureId>,
    /// The last exposure that ended early (abort, light-off, fault, interlock, reset), and its light time, milliseconds.
    pub cut_short: Option<(ExposureId, u32)>,
    /// Whether the light is on.
    pub light_on: bool,
    /// Distance of the plate from the plane in which layers are exposed, micrometres; `None` before homing. In a vat that is the
    /// height above its bottom, in a bed of powder the depth below the working plane.
    pub position_um: Option<i32>,
    /// Whether the plate moves.
    pub moving: bool,
    /// The layer in each slot; only those that were answered with [`Reply::Done`].
    pub slots: Vec<Option<ExposureId>>,
    /// The present fault.
    pub fault: Option<Fault>,
    /// What only powder machines report: present in each of their states, and in no other.
    pub powder: Option<PowderState>,
    /// What only machines with several vats report: present in each of their states, and in no other.
    pub vats: Option<VatsState>,
}

/// What a machine with several vats reports besides what every machine does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct VatsState {
    /// The vat in place; `None` during a change, and after one that did not come to its end.
    pub in_place: Option<u8>,
}

/// What a powder machine reports besides what every machine does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PowderState {
    /// The first vector not marked yet, of the layer that is being marked or, if none is, of the one that was cut short last. Kept
    /// across resets if the device keeps `cut_short`.
    pub next_vector: u32,
    /// Whether the laser went off within that vector, so that part of it is marked.
    pub broken: bool,
    /// Whether powder was spread since the plate moved last.
    pub recoated: bool,
}

/// From host to device, in order, none lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HostMessage {
    /// A request, answered by one [`Reply`] with the same number.
    Request {
        /// Number, ascending, from 1 in each session.
        number: u32,
        /// The request.
        request: Request,
    },
    /// The next bytes of the layer that was begun last.
    LayerData(Vec<u8>),
}

/// A request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Report the state. Answered by [`Reply::State`].
    State,
    /// A layer follows in [`HostMessage::LayerData`]. Answered by [`Reply::Done`] once all bytes have arrived and were decoded, and
    /// the CRC is right. The slot then holds the layer. If the layer is larger than the buffer of a powder machine, the answer comes
    /// when its bytes fill three quarters of that buffer. The rest of such a layer follows while it is marked.
    LayerBegin {
        /// Slot to fill; its former layer is dropped.
        slot: u8,
        /// The layer.
        id: ExposureId,
        /// Its encoding.
        encoding: Encoding,
        /// Number of bytes that follow.
        encoded_bytes: u32,
        /// CRC-32 (IEEE) of the decoded raw rows, or of the decoded vectors.
        decoded_crc32: u32,
    },
    /// A request that only vat machines know.
    Vat(VatRequest),
    /// A request that only powder machines know.
    Powder(PowderRequest),
}

impl Request {
    /// Whether the request lets light out. Such a request must not reach the device after an order to go dark.
    pub const fn is_exposure(&self) -> bool {
        // Without `_`, so that a new kind of machine or act must be decided on here.
        match self {
            Self::State
            | Self::LayerBegin { .. }
            | Self::Vat(VatRequest::Home | VatRequest::Move { .. } | VatRequest::Change { .. })
            | Self::Powder(PowderRequest::Home | PowderRequest::Move { .. } | PowderRequest::Recoat) => false,
            Self::Vat(VatRequest::Expose { .. }) | Self::Powder(PowderRequest::Mark { .. }) => true,
        }
    }
}

/// A request to a vat machine. Each begins an act; acts run one at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VatRequest {
    /// Expose the layer. Answered by [`VatReply::Exposed`] when the light is off again.
    Expose {
        /// The layer. It must be in a slot, which becomes free.
        id: ExposureId,
        /// Commanded light time, milliseconds.
        duration_ms: u32,
        /// Light power, 1 to 255.
        light_pwm: u8,
    },
    /// Find the zero position, plate at the bottom of the vat. Answered by [`VatReply::Moved`].
    Home,
    /// Move the plate. Answered by [`VatReply::Moved`] on arrival.
    Move {
        /// Target above the bottom of the vat, micrometres.
        position_um: i32,
        /// Speed, micrometres a second.
        speed_um_s: u32,
    },
    /// Put another vat in place, and wash what hangs on the plate in between. The host lifts the plate clear of the resin before. Answered by
    /// [`VatReply::Changed`] when the vat is in place.
    Change {
        /// The vat, from 1 on.
        vat: u8,
        /// How long to wash, milliseconds.
        wash_ms: u32,
        /// How long to let it drain after that, milliseconds.
        drain_ms: u32,
    },
}

/// A request to a powder machine. Each begins an act; acts run one at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowderRequest {
    /// Find the zero position: plate level with the working plane, recoater at rest. Answered by [`PowderReply::Moved`].
    Home,
    /// Move the plate. Answered by [`PowderReply::Moved`] on arrival.
    Move {
        /// Target below the working plane, micrometres.
        position_um: i32,
        /// Speed, micrometres a second.
        speed_um_s: u32,
    },
    /// Spread powder over the plate. Answered by [`PowderReply::Recoated`] when the recoater is at rest again.
    Recoat,
    /// Mark a layer. Answered by [`PowderReply::Marked`] after its last vector.
    Mark {
        /// The layer. It must be in a slot, which becomes free when the act ends.
        id: ExposureId,
        /// The first vector to mark; those before it are passed over.
        from_vector: u32,
        /// Longest time of the act, milliseconds. After that the laser stops at the end of the vector it is on.
        most_ms: u32,
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
    /// A message that answers no request.
    Report(Report),
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// Done.
    Done,
    /// The state.
    State(DeviceState),
    /// The request was not carried out, and why.
    Refused(Refusal),
    /// An answer that only vat machines give.
    Vat(VatReply),
    /// An answer that only powder machines give.
    Powder(PowderReply),
}

/// An answer of a vat machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VatReply {
    /// The exposure ran its whole time.
    Exposed {
        /// Which.
        id: ExposureId,
        /// Light time as the device reports it, milliseconds.
        duration_ms: u32,
    },
    /// The plate arrived.
    Moved {
        /// Where it is, micrometres.
        position_um: i32,
    },
    /// The vat is in place.
    Changed {
        /// Which.
        vat: u8,
    },
}

/// An answer of a powder machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowderReply {
    /// The plate arrived.
    Moved {
        /// Where it is, micrometres below the working plane.
        position_um: i32,
    },
    /// Powder is spread, and the recoater is at rest.
    Recoated,
    /// The layer is marked to its last vector.
    Marked {
        /// Which.
        id: ExposureId,
        /// Number of its vectors.
        vectors: u32,
        /// How long the laser was on in this act, milliseconds.
        laser_ms: u32,
        /// How long the laser waited, off, for layer data in this act, milliseconds.
        starved_ms: u32,
    },
}

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Refusal {
    /// The device has a fault or was aborted; a new hello clears an abort.
    NotReady = 1,
    /// That exposure, or a later one of its job, has already run its whole time.
    AlreadyExposed = 2,
    /// Longer than the device's maximum, 0 ms, or at light power 0.
    BadDuration = 3,
    /// No slot holds that layer, or there is no such slot.
    NoSuchLayer = 4,
    /// The slot is being exposed or marked.
    SlotBusy = 5,
    /// The layer cannot be decoded, has a wrong CRC or length, or was not finished.
    BadLayer = 6,
    /// The device does not decode that encoding.
    BadEncoding = 7,
    /// Outside the travel, or at speed 0.
    BadMove = 8,
    /// Not homed.
    NotHomed = 9,
    /// An act is running, or waits for Release.
    Busy = 10,
    /// Began, and was ended early by an abort, a light-off, a fault or an interlock; marking also by its longest time or by bad layer
    /// data.
    CutShort = 11,
    /// The device does not know the request, or it is malformed.
    Unknown = 12,
    /// No powder was spread since the plate moved last.
    NotRecoated = 13,
    /// The layer was marked in part, and this is not its next vector; or the layer has no such vector.
    WrongVector = 14,
    /// The machine has no such vat, or no vat is in place.
    NoSuchVat = 15,
}

/// A message that answers no request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Report {
    /// The device has a fault, or its fault is gone (`None`).
    Fault(Option<Fault>),
    /// A powder machine has room again in the buffer that its layers share.
    Room {
        /// Bytes of layer data that left the buffer since the session began: marked, passed over or dropped. Wraps.
        taken_bytes: u32,
    },
}

/// A condition that keeps a device from working.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The device's own number for it.
    pub code: u16,
    /// For people; at most 120 bytes of UTF-8.
    pub text: String,
}

/// An urgent order. It overtakes all data and is answered at once with its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Urgent {
    /// Light off, stop moving, drop the layers. The device refuses everything until a new hello.
    Abort = 1,
    /// Light off now. A running exposure is cut short.
    LightOff = 2,
    /// Begin no exposure and no move until [`Urgent::Release`]. A running one goes on to its end.
    Hold = 3,
    /// End a hold.
    Release = 4,
}
