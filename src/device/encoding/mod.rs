//! Encodings of a layer's pixels.
//!
//! | encoding  | bits a pixel | what it is                                                        |
//! |-----------|--------------|-------------------------------------------------------------------|
//! | `RawBit`  | 1            | the rows as they are: every device can read it                    |
//! | `Group4`  | 1            | ITU-T T.6 with lit as black: see [`group4`]                       |
//! | `RawGrey` | 8            | the rows as they are                                              |
//! | `RunGrey` | 8            | runs and edge pixels, arithmetically coded: see [`run_grey`]      |
//!
//! An encoder works on whole words and writes into a buffer that is reused for each layer. The [`Decoder`] takes the bytes in
//! pieces as they arrive. Besides the picture it keeps the changes of the last row or a kilobyte of probabilities. It treats
//! every byte as hostile: bad bytes give an error, never a panic. `docs/encodings.md` is for firmware writers.

mod bits;
mod decoder;
mod error;
mod grey_model;
pub mod group4;
mod range;
pub mod run_grey;

pub use decoder::Decoder;
pub use error::DecodeError;

use crate::layer::{Bitmap, Depth};
use crate::link::message::Encoding;

/// The encoding does not fit the depth of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a picture of {depth:?} pixels cannot be written as {encoding:?}")]
pub struct WrongDepth {
    /// What the picture has.
    pub depth: Depth,
    /// What was asked for.
    pub encoding: Encoding,
}

/// The pixel depth of an encoding.
pub fn depth_of(encoding: Encoding) -> Depth {
    match encoding {
        Encoding::RawBit | Encoding::Group4 => Depth::Bit,
        Encoding::RawGrey | Encoding::RunGrey => Depth::Grey,
    }
}

/// How layers are encoded for one device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The encoding that is usually the shortest of those that the device decodes.
    pub encoding: Encoding,
    /// The raw encoding, for layers that are shorter in it; `None` if the device does not decode it.
    pub raw: Option<Encoding>,
}

/// The best encoding for pictures of `depth` among those that a device decodes; `None` if it decodes none.
pub fn choose(depth: Depth, offered: &[Encoding]) -> Option<Choice> {
    let Choice { encoding, raw } = best(depth);
    let raw = raw.filter(|raw| offered.contains(raw));
    let encoding = Some(encoding).filter(|packed| offered.contains(packed)).or(raw)?;
    Some(Choice { encoding, raw })
}

/// The best encoding for pictures of `depth` for a device that decodes all of them.
pub fn best(depth: Depth) -> Choice {
    match depth {
        Depth::Bit => Choice { encoding: Encoding::Group4, raw: Some(Encoding::RawBit) },
        Depth::Grey => Choice { encoding: Encoding::RunGrey, raw: Some(Encoding::RawGrey) },
    }
}

/// CRC-32 (IEEE) of a picture's rows. A device compares it after decoding.
pub fn picture_crc32(bitmap: &Bitmap) -> u32 {
    crc32fast::hash(bitmap.data())
}

/// Writes a picture in the chosen encoding, or raw if that is shorter and the device decodes it. Returns the encoding used.
///
/// # Errors
/// [`WrongDepth`].
pub fn encode_shortest(bitmap: &Bitmap, choice: Choice, bytes: &mut Vec<u8>) -> Result<Encoding, WrongDepth> {
    encode(bitmap, choice.encoding, bytes)?;
    match choice.raw {
        Some(raw) if bytes.len() > bitmap.data().len() => {
            encode(bitmap, raw, bytes)?;
            Ok(raw)
        }
        _ => Ok(choice.encoding),
    }
}

/// The most bytes [`encode`] can write for a picture of `raw_bytes`, in any encoding of `depth`.
///
/// Worst case of Group 4: single pixels of alternating colour, written as horizontal codes. Two pixels take 12 bits, and a row that
/// begins lit takes 8 more: less than seven times the raw picture, plus 24 bits for the end.
///
/// Worst case of RunGrey: every second pixel breaks a run. Two pixels take 9 learned bits, which cost at most 1.03 bits each on
/// average, and 21 even bits: less than twice the raw picture, plus 4 bytes for the end.
pub fn largest_encoded_bytes(depth: Depth, raw_bytes: u64) -> u64 {
    match depth {
        Depth::Bit => 7 * raw_bytes + 4,
        Depth::Grey => 2 * raw_bytes + 4,
    }
}

/// Writes a picture into `bytes`, which is cleared first and keeps its memory.
///
/// # Errors
/// [`WrongDepth`].
pub fn encode(bitmap: &Bitmap, encoding: Encoding, bytes: &mut Vec<u8>) -> Result<(), WrongDepth> {
    bytes.clear();
    if depth_of(encoding) != bitmap.depth() {
        return Err(WrongDepth { depth: bitmap.depth(), encoding });
    }
    match encoding {
        Encoding::RawBit | Encoding::RawGrey => bytes.extend_from_slice(bitmap.data()),
        Encoding::Group4 => group4::encode(bitmap, bytes),
        Encoding::RunGrey => run_grey::encode(bitmap, bytes),
    }
    Ok(())
}
