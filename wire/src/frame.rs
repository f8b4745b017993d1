//! Frames: type, session, sequence, payload and CRC-32, COBS-encoded and ended by a zero byte. The
//! [crate's example](crate) reads one.

use alloc::vec::Vec;

/// The type of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum FrameKind {
    /// The host opens a session.
    Hello = 1,
    /// The device accepts it.
    Welcome = 2,
    /// The device refuses it.
    HelloRefused = 3,
    /// The device does not know the session of a received frame.
    NoSession = 4,
    /// One message, in either direction, delivered in order.
    Data = 5,
    /// What was received and what may be sent; also the heartbeat.
    Ack = 6,
    /// An urgent order; overtakes data.
    Urgent = 7,
    /// Answer to an urgent frame.
    UrgentDone = 8,
}

impl FrameKind {
    const ALL: [Self; 8] = [
        Self::Hello,
        Self::Welcome,
        Self::HelloRefused,
        Self::NoSession,
        Self::Data,
        Self::Ack,
        Self::Urgent,
        Self::UrgentDone,
    ];

    fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u8 == code)
    }
}

/// One frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// What it is.
    pub kind: FrameKind,
    /// The session it belongs to.
    pub session_id: u32,
    /// Data: its sequence number. Ack: the next one expected. Urgent and its answer: the urgent's number. Else 0.
    pub sequence: u32,
    /// Its content depends on the kind.
    pub payload: Vec<u8>,
}

/// A frame from the line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Decoded {
    /// The frame.
    pub frame: Frame,
    /// Bytes it took on the line, its delimiter included, escapes not.
    pub wire_bytes: usize,
}

/// Bytes between two delimiters that are not a valid frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Longer than the largest frame.
    #[error("longer than the largest frame")]
    TooLong,
    /// Not a COBS encoding, or too short for a frame.
    #[error("malformed")]
    Malformed,
    /// The checksum is wrong.
    #[error("wrong checksum")]
    Checksum,
    /// An intact frame of an unknown kind.
    #[error("unknown frame type {0}")]
    UnknownKind(u8),
}

/// Type, session id, sequence.
const HEADER_BYTES: usize = 9;
/// CRC-32 (IEEE 802.3, reflected, as in zlib) over header and payload.
const CRC_BYTES: usize = 4;
const DELIMITER: u8 = 0;

/// Bytes of a frame for the line, delimiter included.
pub fn encode_frame(kind: FrameKind, session_id: u32, sequence: u32, payload: &[u8]) -> Vec<u8> {
    let mut plain = Vec::with_capacity(HEADER_BYTES + payload.len() + CRC_BYTES);
    plain.push(kind as u8);
    plain.extend_from_slice(&session_id.to_le_bytes());
    plain.extend_from_slice(&sequence.to_le_bytes());
    plain.extend_from_slice(payload);
    let crc = crc32fast::hash(&plain);
    plain.extend_from_slice(&crc.to_le_bytes());
    let mut encoded = cobs::encode_vec(&plain);
    encoded.push(DELIMITER);
    encoded
}

/// The longest payload whose frame has at most `frame_bytes` on the line, whatever its bytes; 0 if not even an empty one fits.
pub fn payload_limit(frame_bytes: usize) -> usize {
    // COBS adds one byte for each 254 or part of them; the delimiter is one more.
    let encoded = frame_bytes.saturating_sub(1);
    (encoded - encoded.div_ceil(255)).saturating_sub(HEADER_BYTES + CRC_BYTES)
}

/// Finds frames in a stream of bytes that arrive in pieces of any size. Holds at most one frame.
#[derive(Debug)]
pub struct FrameDecoder {
    /// Bytes since the last delimiter.
    partial: Vec<u8>,
    largest_frame_bytes: usize,
    /// Skips to the next delimiter, because the frame is too long.
    overlong: bool,
}

impl FrameDecoder {
    /// A decoder for frames of at most `largest_frame_bytes` on the line, delimiter included.
    pub fn new(largest_frame_bytes: usize) -> Self {
        Self { partial: Vec::with_capacity(largest_frame_bytes), largest_frame_bytes, overlong: false }
    }

    /// Takes bytes off `input` up to the end of the next frame; `None` once `input` is empty. After an error, decoding restarts at
    /// the next delimiter. Consecutive delimiters are skipped.
    pub fn next_frame(&mut self, input: &mut &[u8]) -> Option<Result<Decoded, FrameError>> {
        while !input.is_empty() {
            let end = input.iter().position(|&byte| byte == DELIMITER);
            let (piece, rest) = input.split_at(end.unwrap_or(input.len()));
            *input = rest;
            if self.partial.len() + piece.len() >= self.largest_frame_bytes {
                self.overlong = true;
                self.partial.clear();
            } else if !self.overlong {
                self.partial.extend_from_slice(piece);
            }
            if end.is_some() {
                *input = &input[1..];
                if core::mem::take(&mut self.overlong) {
                    self.partial.clear();
                    return Some(Err(FrameError::TooLong));
                }
                if !self.partial.is_empty() {
                    let decoded = decode_frame(&mut self.partial);
                    self.partial.clear();
                    return Some(decoded);
                }
            }
        }
        None
    }
}

/// Decodes the bytes between two delimiters in place.
fn decode_frame(encoded: &mut [u8]) -> Result<Decoded, FrameError> {
    let wire_bytes = encoded.len() + 1;
    let length = cobs::decode_in_place(encoded).map_err(|_| FrameError::Malformed)?;
    let plain = &encoded[..length];
    let (body, crc) = plain.split_last_chunk::<CRC_BYTES>().ok_or(FrameError::Malformed)?;
    let (&code, fields) = body.split_first().ok_or(FrameError::Malformed)?;
    let (session_id, fields) = fields.split_first_chunk::<4>().ok_or(FrameError::Malformed)?;
    let (sequence, payload) = fields.split_first_chunk::<4>().ok_or(FrameError::Malformed)?;
    if crc32fast::hash(body) != u32::from_le_bytes(*crc) {
        return Err(FrameError::Checksum);
    }
    let frame = Frame {
        kind: FrameKind::from_code(code).ok_or(FrameError::UnknownKind(code))?,
        session_id: u32::from_le_bytes(*session_id),
        sequence: u32::from_le_bytes(*sequence),
        payload: payload.to_vec(),
    };
    Ok(Decoded { frame, wire_bytes })
}
