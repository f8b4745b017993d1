//! Compression of a chunk: one zstd frame, with a block of its own for every byte plane.
//!
//! A block has its own table of symbols. Left to itself zstd would put all planes of a chunk, noise and constants alike, into
//! one block under one table.

use std::io;

use zstd::stream::raw::{CParameter, Encoder, InBuffer, Operation, OutBuffer};

use super::chunk::Unpacked;

/// Compression level: level 9 would make files of irregular lattices 3 % smaller and take twice the time of all the rest of a
/// chunk. Decoding is as fast at any level.
const LEVEL: i32 = 3;

/// Compresses chunks, one after another.
pub(super) struct Packer {
    encoder: Encoder<'static>,
}

impl Packer {
    /// # Errors
    /// Where zstd cannot have its memory.
    pub(super) fn new() -> io::Result<Self> {
        let mut encoder = Encoder::new(LEVEL)?;
        // The index has a CRC of each chunk.
        encoder.set_parameter(CParameter::ChecksumFlag(false))?;
        Ok(Self { encoder })
    }

    /// Compresses one chunk.
    ///
    /// # Errors
    /// Where zstd cannot have its memory.
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

/// A block's head; what does not compress is stored behind it as it is.
const BLOCK_COST_BYTES: usize = 3;

/// Room was made for the longest result: nothing can be left over.
fn whole(bytes_left: usize) -> io::Result<()> {
    if bytes_left == 0 { Ok(()) } else { Err(io::Error::other(format!("zstd leaves {bytes_left} bytes over"))) }
}
