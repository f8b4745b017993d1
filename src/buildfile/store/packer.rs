//! Compresses a chunk as one zstd frame, with one block for each byte plane.
//!
//! Every block has its own table of symbols. By default zstd would put all planes of a chunk, noise and constants, into one block with
//! one table. `encoders` uses it.

use std::io;

use zstd::stream::raw::{CParameter, Encoder, InBuffer, Operation, OutBuffer};

use crate::buildfile::primitive::Unpacked;

/// Compression level. Level 9 would make files of irregular lattices 3 % smaller, but take twice as long as everything else that is done
/// for a chunk. Decoding takes the same time at all levels.
const LEVEL: i32 = 3;

/// Compresses chunks one after another.
pub(super) struct Packer {
    encoder: Encoder<'static>,
}

impl Packer {
    /// # Errors
    /// If zstd cannot allocate its memory.
    pub(super) fn new() -> io::Result<Self> {
        let mut encoder = Encoder::new(LEVEL)?;
        // Not needed: the index has a CRC of each chunk.
        encoder.set_parameter(CParameter::ChecksumFlag(false))?;
        Ok(Self { encoder })
    }

    /// Compresses one chunk.
    ///
    /// # Errors
    /// If zstd cannot allocate its memory.
    pub(super) fn pack(&mut self, chunk: &Unpacked) -> io::Result<Vec<u8>> {
        let bytes = &chunk.bytes;
        let mut out = Vec::with_capacity(
            zstd::zstd_safe::compress_bound(bytes.len()) + BLOCK_COST_BYTES * (chunk.planes.len() + 1),
        );
        self.encoder.reinit()?;
        self.encoder.set_pledged_src_size(Some(bytes.len() as u64))?;
        let mut packed = OutBuffer::around(&mut out);
        let mut begin = 0;
        for end in chunk.planes.iter().copied().chain([bytes.len()]) {
            let mut input = InBuffer::around(&bytes[begin..end]);
            self.encoder.run(&mut input, &mut packed)?;
            whole(input.src.len() - input.pos())?;
            if end < bytes.len() {
                whole(self.encoder.flush(&mut packed)?)?;
            }
            begin = end;
        }
        whole(self.encoder.finish(&mut packed, false)?)?;
        Ok(out)
    }
}

/// Length of the header of a block. Data that does not compress is stored after it unchanged.
const BLOCK_COST_BYTES: usize = 3;

/// There was room for the longest result, so nothing can be left over.
fn whole(bytes_left: usize) -> io::Result<()> {
    if bytes_left == 0 { Ok(()) } else { Err(io::Error::other(format!("zstd leaves {bytes_left} bytes over"))) }
}
