//! One chunk: up to [`MAX_CHUNK_PRIMITIVES`] primitives of one body, compressed together.

use std::io;

use super::index::ChunkEntry;
use crate::buildfile::primitive::{Primitive, Scratch};
use crate::disk::File;

/// Most primitives in one chunk. So many that the fixed cost of a chunk (40 bytes of index, a head, the compressor's tables) is small; more
/// would take memory for nothing.
pub(crate) const MAX_CHUNK_PRIMITIVES: usize = 8192;

/// Most bytes of an unpacked chunk: twice what 8192 triangles take in the widest columns, three times what struts take.
pub(super) const MAX_UNPACKED_BYTES: u32 = 1 << 20;

/// Most bytes of a packed chunk. No compressor makes a chunk twice as long.
pub(super) const MAX_PACKED_BYTES: u32 = 2 * MAX_UNPACKED_BYTES;

/// Memory of a decompressor, bytes, about.
const DECOMPRESSOR_BYTES: usize = 160 << 10;

/// Reads chunks, with buffers that are kept from chunk to chunk.
#[derive(Default)]
pub(super) struct ChunkReader {
    packed: Vec<u8>,
    unpacked: Vec<u8>,
    scratch: Scratch,
    decompressor: Option<zstd::bulk::Decompressor<'static>>,
}

/// Why a chunk could not be read.
#[derive(Debug)]
pub(super) enum ChunkError {
    /// The file could not be read.
    Read(io::Error),
    /// The chunk is damaged; the text says how.
    Damaged(String),
}

impl ChunkReader {
    /// Memory of a reader of chunks like these, bytes, at most; `primitive_bytes` is their [`Primitive::SCRATCH_BYTES`].
    pub(super) fn memory_bytes(chunks: &[ChunkEntry], primitive_bytes: usize) -> usize {
        let largest = |length: fn(&ChunkEntry) -> u32| chunks.iter().map(length).max().unwrap_or(0) as usize;
        largest(|entry| entry.packed_bytes)
            + largest(|entry| entry.unpacked_bytes)
            + largest(|entry| entry.count) * primitive_bytes
            + DECOMPRESSOR_BYTES
    }

    /// Reads the chunk of an index entry and appends its primitives to `out`.
    ///
    /// # Errors
    /// If the file cannot be read, or the chunk is damaged or contradicts `entry` or `body`. Then `out` is as before.
    pub(super) fn read<P: Primitive>(
        &mut self,
        file: &File,
        entry: &ChunkEntry,
        body: &P::Body,
        out: &mut Vec<P>,
    ) -> Result<(), ChunkError> {
        let packed_bytes = entry.packed_bytes as usize;
        self.packed.clear();
        self.packed.reserve_exact(packed_bytes);
        self.packed.resize(packed_bytes, 0);
        file.read_exact_at(&mut self.packed, entry.offset).map_err(ChunkError::Read)?;
        self.unpack(entry).map_err(ChunkError::Damaged)?;
        let first = out.len();
        let decoded = P::decode(&self.unpacked, entry.count, body, &mut self.scratch, out)
            .and_then(|()| check_against_index(&out[first..], entry));
        decoded.map_err(|problem| {
            out.truncate(first);
            ChunkError::Damaged(problem)
        })
    }

    fn unpack(&mut self, entry: &ChunkEntry) -> Result<(), String> {
        if crc32fast::hash(&self.packed) != entry.crc {
            return Err("it is corrupt (CRC)".into());
        }
        let length = entry.unpacked_bytes as usize;
        self.unpacked.clear();
        self.unpacked.reserve_exact(length);
        let decompressor = match &mut self.decompressor {
            Some(decompressor) => decompressor,
            none => none.insert(zstd::bulk::Decompressor::new().map_err(|error| error.to_string())?),
        };
        decompressor
            .decompress_to_buffer(&self.packed, &mut self.unpacked)
            .map_err(|error| format!("it does not decompress: {error}"))?;
        if self.unpacked.len() != length {
            return Err(format!("it unpacks to {} bytes instead of {length}", self.unpacked.len()));
        }
        Ok(())
    }
}

fn check_against_index<P: Primitive>(primitives: &[P], entry: &ChunkEntry) -> Result<(), String> {
    let found = ChunkEntry::describe(primitives, entry.body);
    let stated = ChunkEntry { offset: 0, packed_bytes: 0, unpacked_bytes: 0, crc: 0, ..*entry };
    if found == stated {
        return Ok(());
    }
    Err(format!(
        "it holds {} balls and z from {}..{} to {} quanta, but the index says {} balls and {}..{} to {}",
        found.ball_count,
        found.z_low_min,
        found.z_low_max,
        found.z_high_max,
        stated.ball_count,
        stated.z_low_min,
        stated.z_low_max,
        stated.z_high_max
    ))
}
