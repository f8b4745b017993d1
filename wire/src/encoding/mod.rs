//! Encodings of a layer: of the pixels of a picture, or of [scan vectors](VectorEncoder).
//!
//! | encoding  | bits a pixel | what it is                                                        |
//! |-----------|--------------|-------------------------------------------------------------------|
//! | `RawBit`  | 1            | the rows as they are: every device can read it                    |
//! | `Group4`  | 1            | ITU-T T.6 with lit as black                                       |
//! | `RawGrey` | 8            | the rows as they are                                              |
//! | `RunGrey` | 8            | runs and edge pixels, arithmetically coded                        |
//!
//! A picture is its raw rows, one after the other, from the top. With 1 bit a pixel, 1 is lit, the first pixel of a byte is its
//! highest bit, and each row is padded with 0 to whole bytes. With 8 bits, 0 is dark and 255 is lit.
//!
//! An encoder works on whole words and writes into a buffer that is reused for each layer. The [`Decoder`] takes the bytes in
//! pieces as they arrive. Besides the picture it keeps the changes of the last row or a kilobyte of probabilities. It treats
//! every byte as hostile: bad bytes give an error, never a panic. `docs/encodings.md` is for firmware in other languages.
//!
//! ```
//! use layerd_wire::encoding::{Decoder, PictureEncoding, encode, rows_crc32};
//!
//! // Two rows of twelve pixels.
//! let rows = [0x0f, 0x00, 0x1f, 0x10];
//! let mut bytes = Vec::new();
//! encode(PictureEncoding::Group4, 12, &rows, &mut bytes)?;
//!
//! let mut decoder = Decoder::new(PictureEncoding::Group4, 12, 2);
//! for piece in bytes.chunks(3) {
//!     decoder.push(piece)?;
//! }
//! assert_eq!(decoder.finish()?, (rows.to_vec(), rows_crc32(&rows)));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bits;
mod decoder;
mod error;
mod grey_model;
mod group4;
mod range;
mod run_codes;
mod run_grey;
mod vectors;

use alloc::vec::Vec;

pub use decoder::Decoder;
pub use error::{DecodeError, PartialRow};
pub use vectors::{
    HatchFrame, HatchLine, LaserParameters, LayerSum, MAX_FIELD_UM, MAX_VECTORS, MarkClass, Vector, VectorDecoder,
    VectorEncodeError, VectorEncoder, VectorEncoding, VectorError, largest_vectors_bytes,
};

/// How the pixels of a picture are encoded. See [`Encoding`](crate::message::Encoding).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PictureEncoding {
    /// 1 bit a pixel, as it is.
    RawBit,
    /// 1 bit a pixel, CCITT Group 4.
    Group4,
    /// 8 bits a pixel, as they are.
    RawGrey,
    /// 8 bits a pixel, runs and edge pixels.
    RunGrey,
}

impl PictureEncoding {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 4] = [Self::RawBit, Self::Group4, Self::RawGrey, Self::RunGrey];

    /// Bits of a pixel in the raw rows: 1 or 8.
    pub fn bits_per_pixel(self) -> u32 {
        match self {
            Self::RawBit | Self::Group4 => 1,
            Self::RawGrey | Self::RunGrey => 8,
        }
    }

    /// Bytes of a raw row of `width_px` pixels. Rows of single bits are padded to whole bytes.
    pub fn row_bytes(self, width_px: u32) -> usize {
        match self.bits_per_pixel() {
            1 => (width_px as usize).div_ceil(8),
            _ => width_px as usize,
        }
    }
}

/// CRC-32 (IEEE) of a picture's raw rows. A device compares it after decoding.
pub fn rows_crc32(rows: &[u8]) -> u32 {
    crc32fast::hash(rows)
}

/// The most bytes that [`encode`] can write for a picture of `raw_bytes` bytes.
///
/// Worst case of Group 4: single pixels of alternating colour, written as horizontal codes. Two pixels take 12 bits, and a row that
/// begins lit takes 8 more: less than seven times the raw picture, plus 24 bits for the end.
///
/// Worst case of RunGrey: every second pixel breaks a run. Two pixels take 9 learned bits, which cost at most 1.03 bits each on
/// average, and 21 even bits: less than twice the raw picture, plus 4 bytes for the end.
pub fn largest_encoded_bytes(encoding: PictureEncoding, raw_bytes: u64) -> u64 {
    match encoding {
        PictureEncoding::RawBit | PictureEncoding::RawGrey => raw_bytes,
        PictureEncoding::Group4 => 7 * raw_bytes + 4,
        PictureEncoding::RunGrey => 2 * raw_bytes + 4,
    }
}

/// Writes a picture, given as its raw rows of `width_px` pixels, into `bytes`, which is cleared first and keeps its memory.
///
/// # Errors
/// [`PartialRow`] if `rows` is not a whole number of rows.
pub fn encode(encoding: PictureEncoding, width_px: u32, rows: &[u8], bytes: &mut Vec<u8>) -> Result<(), PartialRow> {
    bytes.clear();
    // A picture without columns has no bytes, however many rows.
    let row_bytes = encoding.row_bytes(width_px).max(1);
    if !rows.len().is_multiple_of(row_bytes) {
        return Err(PartialRow { bytes: rows.len(), row_bytes });
    }
    match encoding {
        PictureEncoding::RawBit | PictureEncoding::RawGrey => bytes.extend_from_slice(rows),
        PictureEncoding::Group4 => group4::encode(rows.chunks_exact(row_bytes), width_px, bytes),
        PictureEncoding::RunGrey => run_grey::encode(rows.chunks_exact(row_bytes), bytes),
    }
    Ok(())
}
