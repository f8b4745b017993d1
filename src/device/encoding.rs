//! How layers are encoded for a device: which encoding, and a [`Layer`] in it. The encodings themselves are in
//! [`layerd_wire::encoding`].
//!
//! ```
//! use layerd::device::encoding::{choose, encode_shortest};
//! use layerd::layer::{Bitmap, Depth};
//! use layerd::link::message::Encoding;
//!
//! // A device states what it decodes.
//! let choice = choose(Depth::Bit, &[Encoding::RawBit, Encoding::Group4]).expect("it decodes bits");
//! let mut bytes = Vec::new();
//! let used = encode_shortest(&Bitmap::new(64, 32, Depth::Bit), choice, &mut bytes)?;
//! assert_eq!((used, bytes.len()), (Encoding::Group4, 7));
//! # Ok::<(), layerd::device::encoding::WrongDepth>(())
//! ```

use layerd_wire::encoding;

use crate::layer::{Bitmap, Depth, Layer};
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

/// How layers are encoded for one device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The encoding that is usually the shortest of those that the device decodes.
    pub encoding: Encoding,
    /// The raw encoding, for layers that are shorter in it; `None` if the device does not decode it.
    pub raw: Option<Encoding>,
}

/// The pixel depth of an encoding.
fn depth_of(encoding: Encoding) -> Depth {
    if encoding.bits_per_pixel() == 1 { Depth::Bit } else { Depth::Grey }
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
    encoding::rows_crc32(bitmap.data())
}

/// Writes a layer as a device takes it. Returns the encoding used, and the CRC-32 of what the device decodes.
///
/// # Errors
/// [`WrongDepth`].
pub fn encode_layer(layer: &Layer, choice: Choice, bytes: &mut Vec<u8>) -> Result<(Encoding, u32), WrongDepth> {
    let Layer::Bitmap(bitmap) = layer;
    Ok((encode_shortest(bitmap, choice, bytes)?, picture_crc32(bitmap)))
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
pub fn largest_encoded_bytes(depth: Depth, raw_bytes: u64) -> u64 {
    // Never less than the raw rows.
    encoding::largest_encoded_bytes(best(depth).encoding, raw_bytes)
}

/// Writes a picture into `bytes`, which is cleared first and keeps its memory.
///
/// # Errors
/// [`WrongDepth`].
pub fn encode(bitmap: &Bitmap, encoding: Encoding, bytes: &mut Vec<u8>) -> Result<(), WrongDepth> {
    let wrong = WrongDepth { depth: bitmap.depth(), encoding };
    if depth_of(encoding) != bitmap.depth() {
        return Err(wrong);
    }
    // A bitmap has whole rows of its depth.
    encoding::encode(encoding, bitmap.width_px(), bitmap.data(), bytes).map_err(|_| wrong)
}
