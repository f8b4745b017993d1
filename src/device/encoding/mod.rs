//! How a layer's pixels are written for a device, and read again.
//!
//! | encoding  | bits a pixel | what it is                                                        |
//! |-----------|--------------|-------------------------------------------------------------------|
//! | `RawBit`  | 1            | the rows as they are: every device can read it                    |
//! | `Group4`  | 1            | ITU-T T.6 with lit as black: see [`group4`]                       |
//! | `RawGrey` | 8            | the rows as they are                                              |
//! | `RunGrey` | 8            | runs and edge pixels, arithmetically coded: see [`run_grey`]      |
//!
//! An encoder works through whole words and writes into a buffer that is used again for each layer. The [`Decoder`] takes
//! the bytes in pieces as they arrive, keeps no more than the picture itself and the last row's transitions or a kilobyte of
//! probabilities, and treats every byte as hostile: it ends in an error, never in a panic. `docs/encodings.md` is the text for firmware writers.

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

/// A picture of one depth was to be written in an encoding of the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a picture of {depth:?} pixels cannot be written as {encoding:?}")]
pub struct WrongDepth {
    /// What the picture has.
    pub depth: Depth,
    /// What was asked for.
    pub encoding: Encoding,
}

/// The pixels an encoding carries.
pub fn depth_of(encoding: Encoding) -> Depth {
    match encoding {
        Encoding::RawBit | Encoding::Group4 => Depth::Bit,
        Encoding::RawGrey | Encoding::RunGrey => Depth::Grey,
    }
}

/// How layers are written for one device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The shortest encoding the device decodes, as a rule.
    pub encoding: Encoding,
    /// The rows as they are, for a layer that is shorter so; `None` where the device does not decode them.
    pub raw: Option<Encoding>,
}

/// The best encoding for pictures of `depth` among those a device decodes; `None` where it decodes none.
pub fn choose(depth: Depth, offered: &[Encoding]) -> Option<Choice> {
    let [packed, raw] = match depth {
        Depth::Bit => [Encoding::Group4, Encoding::RawBit],
        Depth::Grey => [Encoding::RunGrey, Encoding::RawGrey],
    };
    let raw = Some(raw).filter(|raw| offered.contains(raw));
    let encoding = Some(packed).filter(|packed| offered.contains(packed)).or(raw)?;
    Some(Choice { encoding, raw })
}

/// CRC-32 (IEEE) of a picture's rows: what a device compares after decoding.
pub fn picture_crc32(bitmap: &Bitmap) -> u32 {
    crc32fast::hash(bitmap.data())
}

/// Writes a picture in the chosen encoding, or raw where that is shorter and decoded, and says which it was.
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
/// Group 4 at its worst writes single pixels of alternating colour as horizontal codes, 12 bits for two pixels, and 8 bits
/// more for a row that begins lit: less than seven times the raw picture, and the 24 bits of its end.
///
/// RunGrey at its worst breaks a run with every second pixel. A learned bit costs at most 1.03 bits on average, whatever the
/// pixels are; 9 of them and 21 even bits make two pixels: less than twice the raw picture, and the last 4 bytes.
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
