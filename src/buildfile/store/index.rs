//! The index: what each chunk holds. With it a reader can seek, and bound its memory, before it reads a chunk.
//! `tests/buildfile_damage.rs` damages it.

use bincode::{Decode, Encode};

use crate::buildfile::primitive::Primitive;

/// Position and contents of one chunk; z in quanta. Takes 40 bytes in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub struct ChunkEntry {
    /// Offset of the packed chunk from the start of the file, bytes.
    pub offset: u64,
    /// Length of the packed chunk.
    pub packed_bytes: u32,
    /// Length of the unpacked chunk.
    pub unpacked_bytes: u32,
    /// CRC-32 (IEEE) of the packed chunk.
    pub crc: u32,
    /// Primitives in this chunk: of a lattice, struts and balls.
    pub count: u32,
    /// How many of them are balls.
    pub ball_count: u16,
    /// Index of their body in the header.
    pub body: u16,
    /// Lowest z of the first primitive.
    pub z_low_min: i32,
    /// Lowest z of the last primitive. The next chunk of the body begins no lower.
    pub z_low_max: i32,
    /// Highest z of any primitive.
    pub z_high_max: i32,
}

impl ChunkEntry {
    /// Length of one entry in the file.
    pub(super) const BYTES: usize = 40;

    /// The entry of a chunk of `primitives`, with offset, lengths and CRC 0.
    pub(super) fn describe<P: Primitive>(primitives: &[P], body: u16) -> Self {
        let z_low = |primitive: Option<&P>| primitive.map_or(0, |primitive| primitive.z_range()[0]);
        Self {
            offset: 0,
            packed_bytes: 0,
            unpacked_bytes: 0,
            crc: 0,
            count: primitives.len() as u32,
            ball_count: primitives.iter().filter(|primitive| primitive.is_ball()).count() as u16,
            body,
            z_low_min: z_low(primitives.first()),
            z_low_max: z_low(primitives.last()),
            z_high_max: primitives.iter().map(|primitive| primitive.z_range()[1]).max().unwrap_or(0),
        }
    }
}
