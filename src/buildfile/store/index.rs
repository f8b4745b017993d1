//! The index: what each chunk holds, so that a reader can seek and bound its memory without reading struts.

use bincode::{Decode, Encode};

use crate::buildfile::model::Strut;

/// Where one chunk lies and what it holds; z in quanta. Encoded in 40 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub struct ChunkEntry {
    /// Byte offset of the compressed chunk from the start of the file.
    pub offset: u64,
    /// Compressed length.
    pub packed_bytes: u32,
    /// Length once unpacked.
    pub unpacked_bytes: u32,
    /// CRC-32 (IEEE) of the compressed bytes.
    pub crc: u32,
    /// Struts and balls in this chunk.
    pub strut_count: u32,
    /// How many of them are balls.
    pub ball_count: u16,
    /// The body they belong to: its place in the header.
    pub body: u16,
    /// Lowest node z of the first strut.
    pub z_low_min: i32,
    /// Lowest node z of the last strut; the next chunk begins no lower.
    pub z_low_max: i32,
    /// Highest node z of any strut.
    pub z_high_max: i32,
}

impl ChunkEntry {
    /// Bytes of one entry in the file.
    pub(super) const BYTES: usize = 40;

    /// What the index says of `struts` of a body, with place, lengths and CRC left 0.
    pub(super) fn describe(struts: &[Strut], body: u16) -> Self {
        Self {
            offset: 0,
            packed_bytes: 0,
            unpacked_bytes: 0,
            crc: 0,
            strut_count: struts.len() as u32,
            ball_count: struts.iter().filter(|strut| strut.is_ball()).count() as u16,
            body,
            z_low_min: struts.first().map_or(0, |strut| strut.a[2]),
            z_low_max: struts.last().map_or(0, |strut| strut.a[2]),
            z_high_max: struts.iter().map(|strut| strut.b[2]).max().unwrap_or(0),
        }
    }
}
