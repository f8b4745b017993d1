//! Encodes and decodes messages, the payload of data frames. The sessions use it; `tests/wire_vectors.rs` of `layerd` holds the
//! bytes.

use alloc::vec::Vec;

use super::bytes::{Reader, WireError, Writer};
use super::message::{
    Capabilities, DeviceMessage, DeviceState, Encoding, ExposureId, Fault, HostMessage, MachineCapabilities,
    PowderCapabilities, PowderReply, PowderRequest, PowderState, Refusal, Reply, Report, Request, VatCapabilities,
    VatReply, VatRequest, Vats, VatsState,
};

// Kinds of messages.
const REQUEST: u8 = 0x01;
const LAYER_DATA: u8 = 0x02;
const REPLY: u8 = 0x81;
const REPORT: u8 = 0x82;

// Kinds of machines. A machine with one vat is a kind of its own, so that its bytes are those of hosts that know no other.
const VAT: u8 = 1;
const POWDER: u8 = 2;
const VATS: u8 = 3;

// Requests and replies: 0x01 to 0x1F are for every machine, 0x20 to 0x3F for vats, 0x40 to 0x5F for powder.
const STATE: u8 = 0x01;
const LAYER_BEGIN: u8 = 0x02;
const EXPOSE: u8 = 0x20;
const HOME: u8 = 0x21;
const MOVE: u8 = 0x22;
const CHANGE: u8 = 0x23;
const POWDER_HOME: u8 = 0x40;
const POWDER_MOVE: u8 = 0x41;
const RECOAT: u8 = 0x42;
const MARK: u8 = 0x43;

const DONE: u8 = 0x01;
const STATE_IS: u8 = 0x02;
const REFUSED: u8 = 0x03;
const EXPOSED: u8 = 0x20;
const MOVED: u8 = 0x21;
const CHANGED: u8 = 0x22;
const VATS_STATE_IS: u8 = 0x23;
const POWDER_STATE_IS: u8 = 0x40;
const POWDER_MOVED: u8 = 0x41;
const RECOATED: u8 = 0x42;
const MARKED: u8 = 0x43;

// Reports.
const FAULT: u8 = 0x01;
const ROOM: u8 = 0x40;

/// Longest device name, bytes.
const MAX_NAME_BYTES: u8 = 64;
/// Longest text of a fault, bytes.
const MAX_FAULT_BYTES: u8 = 120;
/// Most layer slots of a device. It limits the size of a state, which must fit into a frame.
pub const MAX_SLOTS: u8 = 16;
/// Most encodings in the list of a device.
const MAX_ENCODINGS: u8 = 16;

/// The payload of a data frame to the device.
pub fn encode_host_message(message: &HostMessage) -> Vec<u8> {
    let mut writer = Writer::default();
    match message {
        HostMessage::Request { number, request } => {
            writer.u8(REQUEST).u32(*number);
            write_request(&mut writer, request);
        }
        HostMessage::LayerData(bytes) => {
            writer.u8(LAYER_DATA).raw(bytes);
        }
    }
    writer.finish()
}

/// Reads the payload of a data frame to the device.
///
/// # Errors
/// [`WireError`]; `BadRequest` carries the number to answer.
pub fn decode_host_message(payload: &[u8]) -> Result<HostMessage, WireError> {
    let mut reader = Reader::new(payload);
    match reader.u8("message")? {
        REQUEST => {
            let number = reader.u32("number")?;
            let request = read_request(&mut reader).and_then(|request| reader.end().map(|()| request));
            let request = request.map_err(|_| WireError::BadRequest { number })?;
            Ok(HostMessage::Request { number, request })
        }
        LAYER_DATA => Ok(HostMessage::LayerData(reader.rest().to_vec())),
        other => Err(WireError::BadValue { field: "message", value: other.into() }),
    }
}

/// The payload of a data frame to the host.
pub fn encode_device_message(message: &DeviceMessage) -> Vec<u8> {
    let mut writer = Writer::default();
    match message {
        DeviceMessage::Reply { number, reply } => {
            writer.u8(REPLY).u32(*number);
            write_reply(&mut writer, reply);
        }
        DeviceMessage::Report(Report::Fault(fault)) => {
            writer.u8(REPORT).u8(FAULT).option(fault.as_ref(), write_fault);
        }
        DeviceMessage::Report(Report::Room { taken_bytes }) => {
            writer.u8(REPORT).u8(ROOM).u32(*taken_bytes);
        }
    }
    writer.finish()
}

/// Reads the payload of a data frame to the host.
///
/// # Errors
/// [`WireError`]; an `UnknownReport` may be ignored.
pub fn decode_device_message(payload: &[u8]) -> Result<DeviceMessage, WireError> {
    let mut reader = Reader::new(payload);
    let message = match reader.u8("message")? {
        REPLY => DeviceMessage::Reply { number: reader.u32("number")?, reply: read_reply(&mut reader)? },
        REPORT => match reader.u8("report")? {
            FAULT => DeviceMessage::Report(Report::Fault(reader.option("fault", read_fault)?)),
            ROOM => DeviceMessage::Report(Report::Room { taken_bytes: reader.u32("taken_bytes")? }),
            kind => return Err(WireError::UnknownReport { kind }),
        },
        other => return Err(WireError::BadValue { field: "message", value: other.into() }),
    };
    reader.end()?;
    Ok(message)
}

fn write_request(writer: &mut Writer, request: &Request) {
    match request {
        Request::State => {
            writer.u8(STATE);
        }
        Request::LayerBegin { slot, id, encoding, encoded_bytes, decoded_crc32 } => {
            writer.u8(LAYER_BEGIN).u8(*slot);
            write_id(writer, id);
            writer.u8(*encoding as u8).u32(*encoded_bytes).u32(*decoded_crc32);
        }
        Request::Vat(VatRequest::Expose { id, duration_ms, light_pwm }) => {
            writer.u8(EXPOSE);
            write_id(writer, id);
            writer.u32(*duration_ms).u8(*light_pwm);
        }
        Request::Vat(VatRequest::Home) => {
            writer.u8(HOME);
        }
        Request::Vat(VatRequest::Move { position_um, speed_um_s }) => {
            writer.u8(MOVE).i32(*position_um).u32(*speed_um_s);
        }
        Request::Vat(VatRequest::Change { vat, wash_ms, drain_ms }) => {
            writer.u8(CHANGE).u8(*vat).u32(*wash_ms).u32(*drain_ms);
        }
        Request::Powder(request) => write_powder_request(writer, request),
    }
}

fn write_powder_request(writer: &mut Writer, request: &PowderRequest) {
    match request {
        PowderRequest::Home => {
            writer.u8(POWDER_HOME);
        }
        PowderRequest::Move { position_um, speed_um_s } => {
            writer.u8(POWDER_MOVE).i32(*position_um).u32(*speed_um_s);
        }
        PowderRequest::Recoat => {
            writer.u8(RECOAT);
        }
        PowderRequest::Mark { id, from_vector, most_ms } => {
            writer.u8(MARK);
            write_id(writer, id);
            writer.u32(*from_vector).u32(*most_ms);
        }
    }
}

fn read_request(reader: &mut Reader<'_>) -> Result<Request, WireError> {
    Ok(match reader.u8("request")? {
        STATE => Request::State,
        LAYER_BEGIN => Request::LayerBegin {
            slot: reader.u8("slot")?,
            id: read_id(reader)?,
            encoding: read_encoding(reader)?,
            encoded_bytes: reader.u32("encoded_bytes")?,
            decoded_crc32: reader.u32("decoded_crc32")?,
        },
        EXPOSE => Request::Vat(VatRequest::Expose {
            id: read_id(reader)?,
            duration_ms: reader.u32("duration_ms")?,
            light_pwm: reader.u8("light_pwm")?,
        }),
        HOME => Request::Vat(VatRequest::Home),
        MOVE => Request::Vat(VatRequest::Move {
            position_um: reader.i32("position_um")?,
            speed_um_s: reader.u32("speed_um_s")?,
        }),
        CHANGE => Request::Vat(VatRequest::Change {
            vat: reader.u8("vat")?,
            wash_ms: reader.u32("wash_ms")?,
            drain_ms: reader.u32("drain_ms")?,
        }),
        POWDER_HOME => Request::Powder(PowderRequest::Home),
        POWDER_MOVE => Request::Powder(PowderRequest::Move {
            position_um: reader.i32("position_um")?,
            speed_um_s: reader.u32("speed_um_s")?,
        }),
        RECOAT => Request::Powder(PowderRequest::Recoat),
        MARK => Request::Powder(PowderRequest::Mark {
            id: read_id(reader)?,
            from_vector: reader.u32("from_vector")?,
            most_ms: reader.u32("most_ms")?,
        }),
        other => return Err(WireError::BadValue { field: "request", value: other.into() }),
    })
}

fn write_reply(writer: &mut Writer, reply: &Reply) {
    match reply {
        Reply::Done => {
            writer.u8(DONE);
        }
        Reply::State(state) => {
            writer.u8(match (&state.powder, &state.vats) {
                (Some(_), _) => POWDER_STATE_IS,
                (None, Some(_)) => VATS_STATE_IS,
                (None, None) => STATE_IS,
            });
            write_state(writer, state);
        }
        Reply::Refused(refusal) => {
            writer.u8(REFUSED).u8(*refusal as u8);
        }
        Reply::Vat(VatReply::Exposed { id, duration_ms }) => {
            writer.u8(EXPOSED);
            write_id(writer, id);
            writer.u32(*duration_ms);
        }
        Reply::Vat(VatReply::Moved { position_um }) => {
            writer.u8(MOVED).i32(*position_um);
        }
        Reply::Vat(VatReply::Changed { vat }) => {
            writer.u8(CHANGED).u8(*vat);
        }
        Reply::Powder(PowderReply::Moved { position_um }) => {
            writer.u8(POWDER_MOVED).i32(*position_um);
        }
        Reply::Powder(PowderReply::Recoated) => {
            writer.u8(RECOATED);
        }
        Reply::Powder(PowderReply::Marked { id, vectors, laser_ms, starved_ms }) => {
            writer.u8(MARKED);
            write_id(writer, id);
            writer.u32(*vectors).u32(*laser_ms).u32(*starved_ms);
        }
    }
}

fn read_reply(reader: &mut Reader<'_>) -> Result<Reply, WireError> {
    Ok(match reader.u8("reply")? {
        DONE => Reply::Done,
        STATE_IS => Reply::State(read_state(reader, StateOf::Vat)?),
        VATS_STATE_IS => Reply::State(read_state(reader, StateOf::Vats)?),
        POWDER_STATE_IS => Reply::State(read_state(reader, StateOf::Powder)?),
        REFUSED => Reply::Refused(read_refusal(reader)?),
        EXPOSED => Reply::Vat(VatReply::Exposed { id: read_id(reader)?, duration_ms: reader.u32("duration_ms")? }),
        MOVED => Reply::Vat(VatReply::Moved { position_um: reader.i32("position_um")? }),
        CHANGED => Reply::Vat(VatReply::Changed { vat: reader.u8("vat")? }),
        POWDER_MOVED => Reply::Powder(PowderReply::Moved { position_um: reader.i32("position_um")? }),
        RECOATED => Reply::Powder(PowderReply::Recoated),
        MARKED => Reply::Powder(PowderReply::Marked {
            id: read_id(reader)?,
            vectors: reader.u32("vectors")?,
            laser_ms: reader.u32("laser_ms")?,
            starved_ms: reader.u32("starved_ms")?,
        }),
        other => return Err(WireError::BadValue { field: "reply", value: other.into() }),
    })
}

pub(super) fn write_capabilities(writer: &mut Writer, capabilities: &Capabilities) {
    writer
        .text(&capabilities.name, MAX_NAME_BYTES)
        .u8(capabilities.layer_slots)
        .u32(capabilities.window_bytes)
        .u16(capabilities.largest_frame_bytes)
        .list(&capabilities.encodings, MAX_ENCODINGS, |writer, encoding| {
            writer.u8(*encoding as u8);
        })
        .u32(capabilities.max_exposure_ms);
    match &capabilities.machine {
        MachineCapabilities::Vat(vat) => {
            writer
                .u8(if vat.vats == Vats::ONE { VAT } else { VATS })
                .u32(vat.width_px)
                .u32(vat.height_px)
                .u32(vat.pixel_nm[0])
                .u32(vat.pixel_nm[1])
                .i32(vat.max_position_um);
            if vat.vats != Vats::ONE {
                writer.u8(vat.vats.count).u32(vat.vats.change_ms);
            }
            writer
        }
        MachineCapabilities::Powder(powder) => writer
            .u8(POWDER)
            .u32(powder.field_um[0])
            .u32(powder.field_um[1])
            .u32(powder.max_power_mw)
            .u32(powder.layer_height_um[0])
            .u32(powder.layer_height_um[1])
            .i32(powder.max_position_um)
            .u32(powder.buffer_bytes),
    };
}

pub(super) fn read_capabilities(reader: &mut Reader<'_>) -> Result<Capabilities, WireError> {
    Ok(Capabilities {
        name: reader.text("name", MAX_NAME_BYTES.into())?,
        layer_slots: reader.u8("layer_slots")?,
        window_bytes: reader.u32("window_bytes")?,
        largest_frame_bytes: reader.u16("largest_frame_bytes")?,
        // A device may list encodings of its own; the host uses those it knows.
        encodings: reader
            .list("encodings", MAX_ENCODINGS.into(), |reader| reader.u8("encoding"))?
            .into_iter()
            .filter_map(encoding_from_code)
            .collect(),
        max_exposure_ms: reader.u32("max_exposure_ms")?,
        machine: match reader.u8("machine")? {
            kind @ (VAT | VATS) => MachineCapabilities::Vat(VatCapabilities {
                width_px: reader.u32("width_px")?,
                height_px: reader.u32("height_px")?,
                pixel_nm: [reader.u32("pixel_nm")?, reader.u32("pixel_nm")?],
                max_position_um: reader.i32("max_position_um")?,
                vats: if kind == VATS { read_vats(reader)? } else { Vats::ONE },
            }),
            POWDER => MachineCapabilities::Powder(PowderCapabilities {
                field_um: [reader.u32("field_um")?, reader.u32("field_um")?],
                max_power_mw: reader.u32("max_power_mw")?,
                layer_height_um: [reader.u32("layer_height_um")?, reader.u32("layer_height_um")?],
                max_position_um: reader.i32("max_position_um")?,
                buffer_bytes: reader.u32("buffer_bytes")?,
            }),
            kind => return Err(WireError::UnknownMachine { kind }),
        },
    })
}

pub(super) fn write_state(writer: &mut Writer, state: &DeviceState) {
    writer
        .u32(state.boot_id)
        .option(state.last_exposed.as_ref(), write_id)
        .option(state.exposing.as_ref(), write_id)
        .option(state.cut_short.as_ref(), |writer, (id, light_ms)| {
            write_id(writer, id);
            writer.u32(*light_ms);
        })
        .bool(state.light_on)
        .option(state.position_um.as_ref(), |writer, position_um| {
            writer.i32(*position_um);
        })
        .bool(state.moving)
        .list(&state.slots, MAX_SLOTS, |writer, slot| {
            writer.option(slot.as_ref(), write_id);
        })
        .option(state.fault.as_ref(), write_fault);
    if let Some(VatsState { in_place }) = state.vats {
        writer.option(in_place.as_ref(), |writer, vat| {
            writer.u8(*vat);
        });
    }
    if let Some(PowderState { next_vector, broken, recoated }) = state.powder {
        writer.u32(next_vector).bool(broken).bool(recoated);
    }
}

/// Whose state it is: what a state holds besides what all have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StateOf {
    Vat,
    Vats,
    Powder,
}

impl StateOf {
    /// Of a machine with these capabilities.
    pub(super) fn of(machine: &MachineCapabilities) -> Self {
        match machine {
            MachineCapabilities::Vat(vat) if vat.vats == Vats::ONE => Self::Vat,
            MachineCapabilities::Vat(_) => Self::Vats,
            MachineCapabilities::Powder(_) => Self::Powder,
        }
    }
}

fn read_vats(reader: &mut Reader<'_>) -> Result<Vats, WireError> {
    let vats = Vats { count: reader.u8("vats")?, change_ms: reader.u32("change_ms")? };
    if vats.count < 2 {
        return Err(WireError::BadValue { field: "vats", value: vats.count.into() });
    }
    Ok(vats)
}

/// Reads the state of such a machine.
pub(super) fn read_state(reader: &mut Reader<'_>, of: StateOf) -> Result<DeviceState, WireError> {
    Ok(DeviceState {
        boot_id: reader.u32("boot_id")?,
        last_exposed: reader.option("last_exposed", read_id)?,
        exposing: reader.option("exposing", read_id)?,
        cut_short: reader.option("cut_short", |reader| Ok((read_id(reader)?, reader.u32("light_ms")?)))?,
        light_on: reader.bool("light_on")?,
        position_um: reader.option("position_um", |reader| reader.i32("position_um"))?,
        moving: reader.bool("moving")?,
        slots: reader.list("slots", MAX_SLOTS.into(), |reader| reader.option("slot", read_id))?,
        fault: reader.option("fault", read_fault)?,
        vats: match of {
            StateOf::Vats => Some(VatsState { in_place: reader.option("in_place", |reader| reader.u8("in_place"))? }),
            StateOf::Vat | StateOf::Powder => None,
        },
        powder: (of == StateOf::Powder).then(|| read_powder_state(reader)).transpose()?,
    })
}

fn read_powder_state(reader: &mut Reader<'_>) -> Result<PowderState, WireError> {
    Ok(PowderState {
        next_vector: reader.u32("next_vector")?,
        broken: reader.bool("broken")?,
        recoated: reader.bool("recoated")?,
    })
}

fn write_id(writer: &mut Writer, id: &ExposureId) {
    writer.u64(id.job).u32(id.layer).u8(id.pass);
}

fn read_id(reader: &mut Reader<'_>) -> Result<ExposureId, WireError> {
    Ok(ExposureId { job: reader.u64("job")?, layer: reader.u32("layer")?, pass: reader.u8("pass")? })
}

fn write_fault(writer: &mut Writer, fault: &Fault) {
    writer.u16(fault.code).text(&fault.text, MAX_FAULT_BYTES);
}

fn read_fault(reader: &mut Reader<'_>) -> Result<Fault, WireError> {
    Ok(Fault { code: reader.u16("code")?, text: reader.text("text", MAX_FAULT_BYTES.into())? })
}

fn read_encoding(reader: &mut Reader<'_>) -> Result<Encoding, WireError> {
    let code = reader.u8("encoding")?;
    encoding_from_code(code).ok_or(WireError::BadValue { field: "encoding", value: code.into() })
}

fn encoding_from_code(code: u8) -> Option<Encoding> {
    Encoding::ALL.into_iter().find(|encoding| *encoding as u8 == code)
}

fn read_refusal(reader: &mut Reader<'_>) -> Result<Refusal, WireError> {
    let code = reader.u8("refusal")?;
    let known = [
        Refusal::NotReady,
        Refusal::AlreadyExposed,
        Refusal::BadDuration,
        Refusal::NoSuchLayer,
        Refusal::SlotBusy,
        Refusal::BadLayer,
        Refusal::BadEncoding,
        Refusal::BadMove,
        Refusal::NotHomed,
        Refusal::Busy,
        Refusal::CutShort,
        Refusal::Unknown,
        Refusal::NotRecoated,
        Refusal::WrongVector,
        Refusal::NoSuchVat,
    ];
    let refusal = known.into_iter().find(|refusal| *refusal as u8 == code);
    refusal.ok_or(WireError::BadValue { field: "refusal", value: code.into() })
}
