//! How layers are encoded for a device: which encoding, and a [`Bitmap`] or [`Vectors`] in it. The encodings themselves are in
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

use layerd_wire::encoding::{
    self, LaserParameters, LayerSum, PictureEncoding, VectorEncodeError, VectorEncoder, VectorEncoding,
};

use crate::layer::{Bitmap, Depth, MarkClass, Run, Vectors};
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

/// The pixel depth of a picture's encoding.
pub fn depth_of(encoding: PictureEncoding) -> Depth {
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
    let encodings = PictureEncoding::ALL.into_iter().filter(|encoding| depth_of(*encoding) == depth);
    encodings.map(|encoding| encoding::largest_encoded_bytes(encoding, raw_bytes)).max().unwrap_or(raw_bytes)
}

/// Writes a picture into `bytes`, which is cleared first and keeps its memory.
///
/// # Errors
/// [`WrongDepth`].
pub fn encode(bitmap: &Bitmap, encoding: Encoding, bytes: &mut Vec<u8>) -> Result<(), WrongDepth> {
    let wrong = WrongDepth { depth: bitmap.depth(), encoding };
    let picture = encoding.picture().filter(|picture| depth_of(*picture) == bitmap.depth()).ok_or(wrong)?;
    // A bitmap has whole rows of its depth.
    encoding::encode(picture, bitmap.width_px(), bitmap.data(), bytes).map_err(|_| wrong)
}

/// The best encoding of scan vectors for a device that decodes all of them.
pub const BEST_VECTORS: Choice = Choice { encoding: Encoding::VectorsCoded, raw: None };

/// The best encoding of scan vectors among those that a device decodes; `None` if it decodes none.
pub fn choose_vectors(offered: &[Encoding]) -> Option<Choice> {
    let encoding =
        [Encoding::VectorsCoded, Encoding::Vectors].into_iter().find(|encoding| offered.contains(encoding))?;
    Some(Choice { encoding, raw: None })
}

/// Writes vectors into `bytes`, which is cleared first and keeps its memory. `lasers` has the parameters of each class, in the order of
/// the classes' numbers; those of the classes that occur are written. The device's field has the sides `field_um`. Returns what the
/// device computes of the vectors, too.
///
/// # Errors
/// [`VectorEncodeError`]; the bytes are of no use then.
pub fn encode_vectors(
    vectors: &Vectors,
    encoding: VectorEncoding,
    field_um: [u32; 2],
    lasers: &[LaserParameters; MarkClass::ALL.len()],
    bytes: &mut Vec<u8>,
) -> Result<LayerSum, VectorEncodeError> {
    let mut occurs = [false; MarkClass::ALL.len()];
    vectors.runs().for_each(|(class, _)| occurs[class as usize] = true);
    let used: Vec<_> = MarkClass::ALL.into_iter().filter(|class| occurs[*class as usize]).collect();
    let mut encoder = LayerEncoder::new(encoding, field_um, lasers, &used, bytes)?;
    encoder.add(vectors)?;
    encoder.finish()
}

/// Writes a layer whose vectors come in groups.
#[derive(Debug)]
pub struct LayerEncoder<'a> {
    encoder: VectorEncoder<'a>,
    /// Single points that follow each other take one run.
    points: (MarkClass, Vec<[i32; 2]>),
}

/// Most single points that wait for a run. Longer runs save nothing.
const MAX_POINTS: usize = 1 << 12;

impl<'a> LayerEncoder<'a> {
    /// Begins a layer, as [`encode_vectors`]. `classes`: those that may occur, in the order of their numbers.
    ///
    /// # Errors
    /// [`VectorEncodeError`].
    pub fn new(
        encoding: VectorEncoding,
        field_um: [u32; 2],
        lasers: &[LaserParameters; MarkClass::ALL.len()],
        classes: &[MarkClass],
        bytes: &'a mut Vec<u8>,
    ) -> Result<Self, VectorEncodeError> {
        let table: Vec<_> = classes.iter().map(|class| (*class, lasers[*class as usize])).collect();
        let encoder = VectorEncoder::new(encoding, field_um, &table, bytes)?;
        Ok(Self { encoder, points: (MarkClass::Point, Vec::new()) })
    }

    /// Adds vectors.
    ///
    /// # Errors
    /// [`VectorEncodeError`].
    pub fn add(&mut self, vectors: &Vectors) -> Result<(), VectorEncodeError> {
        for (class, run) in vectors.runs() {
            if let Run::Path(&[point_um]) = run {
                if class != self.points.0 || self.points.1.len() == MAX_POINTS {
                    self.write_points()?;
                    self.points.0 = class;
                }
                self.points.1.push(point_um);
                continue;
            }
            self.write_points()?;
            match run {
                Run::Path(points_um) => self.encoder.path(class, points_um)?,
                Run::Hatches(frame, lines) => self.encoder.hatches(class, frame, lines.iter().copied())?,
            }
        }
        Ok(())
    }

    /// Number of bytes so far. Some are still to come of what was added.
    pub fn written_bytes(&self) -> usize {
        self.encoder.written_bytes()
    }

    /// Ends the layer. Returns what the device computes of the vectors, too.
    ///
    /// # Errors
    /// [`VectorEncodeError`].
    pub fn finish(mut self) -> Result<LayerSum, VectorEncodeError> {
        self.write_points()?;
        Ok(self.encoder.finish())
    }

    fn write_points(&mut self) -> Result<(), VectorEncodeError> {
        self.encoder.points(self.points.0, &self.points.1)?;
        self.points.1.clear();
        Ok(())
    }
}
