//! Converts between raw bytes and frames: escapes, delimiters, counts. `endpoint` uses it at both ends of a session.

use alloc::vec::Vec;

use crate::{Decoded, FrameDecoder, FrameError, FrameKind, Unescaper, encode_frame, escape};

use super::Statistics;

/// The byte side of a session.
#[derive(Debug)]
pub struct Line {
    decoder: FrameDecoder,
    /// Present with XON/XOFF.
    unescaper: Option<Unescaper>,
    /// Counts.
    pub statistics: Statistics,
}

impl Line {
    /// For frames of at most `largest_frame_bytes` from the line. `escaped`: XON/XOFF is in use.
    pub fn new(largest_frame_bytes: usize, escaped: bool, statistics: Statistics) -> Self {
        let unescaper = escaped.then(Unescaper::default);
        Self { decoder: FrameDecoder::new(largest_frame_bytes), unescaper, statistics }
    }

    /// The frames that end in `bytes`.
    pub fn receive(&mut self, bytes: &[u8]) -> Vec<Decoded> {
        self.statistics.bytes_received += bytes.len() as u64;
        let mut plain = Vec::new();
        let mut input = match &mut self.unescaper {
            None => bytes,
            Some(unescaper) => {
                unescaper.push(bytes, &mut plain);
                &plain
            }
        };
        let mut frames = Vec::new();
        while let Some(decoded) = self.decoder.next_frame(&mut input) {
            match decoded {
                Ok(decoded) => {
                    self.statistics.frames_received += 1;
                    frames.push(decoded);
                }
                Err(FrameError::Checksum) => self.statistics.crc_errors += 1,
                Err(FrameError::Malformed | FrameError::TooLong | FrameError::UnknownKind(_)) => {
                    self.statistics.malformed_frames += 1;
                }
            }
        }
        frames
    }

    /// A frame as it goes on the line. Hello and urgent frames get a delimiter in front, so that noise or a truncated frame before
    /// them does not destroy them.
    pub fn frame(&mut self, kind: FrameKind, session_id: u32, sequence: u32, payload: &[u8]) -> Vec<u8> {
        let mut bytes = encode_frame(kind, session_id, sequence, payload);
        if matches!(kind, FrameKind::Hello | FrameKind::Urgent) {
            bytes.insert(0, 0);
        }
        self.send(&bytes)
    }

    /// An encoded frame as it goes on the line.
    pub(super) fn send(&mut self, encoded: &[u8]) -> Vec<u8> {
        let bytes = if self.unescaper.is_some() { escape(encoded) } else { encoded.to_vec() };
        self.statistics.frames_sent += 1;
        self.statistics.bytes_sent += bytes.len() as u64;
        bytes
    }
}
