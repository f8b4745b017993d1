//! Payloads of all frames except data: hello, welcome, refusal, acknowledgement, urgent. The
//! [crate's example](crate) shows a handshake.

use alloc::vec::Vec;

use super::bytes::{Reader, WireError, Writer};
use super::codec::{StateOf, read_capabilities, read_state, write_capabilities, write_state};
use super::message::{Capabilities, DeviceState, Urgent};
use super::version::{VERSIONS, VersionRange};

/// What the host states when it opens a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Versions that the host speaks.
    pub versions: VersionRange,
    /// Most unacknowledged bytes of data frames that the device may have in flight.
    pub window_bytes: u32,
    /// Largest frame that the host takes, delimiter included.
    pub largest_frame_bytes: u16,
}

/// What the device states when it accepts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Welcome {
    /// Version of the session: the highest that both ends speak.
    pub version: u16,
    /// What the device is.
    pub capabilities: Capabilities,
    /// What it is doing.
    pub state: DeviceState,
}

/// Why a device does not accept a hello.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HelloRefused {
    /// It speaks none of the host's versions.
    Version {
        /// The versions it speaks.
        device: VersionRange,
    },
    /// The host's window or largest frame is below the limit of the protocol.
    Limits,
}

/// What was received and what may be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ack {
    /// All data frames before this one were received. It is the frame's sequence field.
    pub next_sequence: u32,
    /// A data frame was dropped, because one before it is missing or the buffer was full.
    pub gap: bool,
    /// The last data frame that was heard, taken or not; `next_sequence - 1` before the first.
    pub last_heard: u32,
    /// Room for further data frames beyond those acknowledged, bytes.
    pub free_bytes: u32,
}

/// Answer to an urgent frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UrgentDone {
    /// Whether the light or laser is on now.
    pub light_on: bool,
}

impl Hello {
    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut writer = Writer::default();
        write_versions(&mut writer, self.versions);
        writer.u32(self.window_bytes).u16(self.largest_frame_bytes).finish()
    }

    /// Reads a payload. These fields come first in every version of the protocol. A later version may append fields, which are
    /// ignored.
    ///
    /// # Errors
    /// [`WireError::Short`] if it is too short.
    pub fn decode(payload: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(payload);
        Ok(Self {
            versions: read_versions(&mut reader)?,
            window_bytes: reader.u32("window_bytes")?,
            largest_frame_bytes: reader.u16("largest_frame_bytes")?,
        })
    }
}

impl Welcome {
    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.u16(self.version);
        write_capabilities(&mut writer, &self.capabilities);
        write_state(&mut writer, &self.state);
        writer.finish()
    }

    /// Reads a payload. The version comes first in every version of the protocol.
    ///
    /// # Errors
    /// [`WireError::OtherVersion`] if the version is not one of [`VERSIONS`]; then nothing else is read. Else another [`WireError`],
    /// which names the field that does not fit.
    pub fn decode(payload: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(payload);
        let version = reader.u16("version")?;
        if !VERSIONS.contains(version) {
            return Err(WireError::OtherVersion { version });
        }
        let capabilities = read_capabilities(&mut reader)?;
        let state = read_state(&mut reader, StateOf::of(&capabilities.machine))?;
        reader.end()?;
        // One entry for each slot is the most there can be.
        if state.slots.len() > usize::from(capabilities.layer_slots) {
            return Err(WireError::BadValue { field: "slots", value: state.slots.len() as u32 });
        }
        Ok(Self { version, capabilities, state })
    }
}

impl HelloRefused {
    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        let mut writer = Writer::default();
        match *self {
            Self::Version { device } => write_versions(writer.u8(1), device),
            Self::Limits => writer.u8(2),
        };
        writer.finish()
    }

    /// Reads a payload.
    ///
    /// # Errors
    /// [`WireError`] names the field that does not fit.
    pub fn decode(payload: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(payload);
        let refused = match reader.u8("reason")? {
            1 => Self::Version { device: read_versions(&mut reader)? },
            2 => Self::Limits,
            other => return Err(WireError::BadValue { field: "reason", value: other.into() }),
        };
        reader.end()?;
        Ok(refused)
    }
}

impl Ack {
    /// The payload; `next_sequence` goes into the frame's sequence field.
    pub fn encode(&self) -> Vec<u8> {
        Writer::default().bool(self.gap).u32(self.last_heard).u32(self.free_bytes).finish()
    }

    /// Reads a payload and the frame's sequence field.
    ///
    /// # Errors
    /// [`WireError`] names the field that does not fit.
    pub fn decode(next_sequence: u32, payload: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(payload);
        let ack = Self {
            next_sequence,
            gap: reader.bool("gap")?,
            last_heard: reader.u32("last_heard")?,
            free_bytes: reader.u32("free_bytes")?,
        };
        reader.end()?;
        Ok(ack)
    }
}

impl UrgentDone {
    /// The payload.
    pub fn encode(&self) -> Vec<u8> {
        Writer::default().bool(self.light_on).finish()
    }

    /// Reads a payload.
    ///
    /// # Errors
    /// [`WireError`] names the field that does not fit.
    pub fn decode(payload: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(payload);
        let done = Self { light_on: reader.bool("light_on")? };
        reader.end()?;
        Ok(done)
    }
}

fn write_versions(writer: &mut Writer, versions: VersionRange) -> &mut Writer {
    writer.u16(versions.lowest).u16(versions.highest)
}

fn read_versions(reader: &mut Reader<'_>) -> Result<VersionRange, WireError> {
    Ok(VersionRange { lowest: reader.u16("lowest")?, highest: reader.u16("highest")? })
}

/// The payload of an urgent frame.
pub fn encode_urgent(urgent: Urgent) -> Vec<u8> {
    Writer::default().u8(urgent as u8).finish()
}

/// Reads the payload of an urgent frame.
///
/// # Errors
/// [`WireError`] if it is not exactly one known code.
pub fn decode_urgent(payload: &[u8]) -> Result<Urgent, WireError> {
    let mut reader = Reader::new(payload);
    let code = reader.u8("urgent")?;
    let known = [Urgent::Abort, Urgent::LightOff, Urgent::Hold, Urgent::Release];
    let urgent = known.into_iter().find(|urgent| *urgent as u8 == code);
    reader.end()?;
    urgent.ok_or(WireError::BadValue { field: "urgent", value: code.into() })
}
