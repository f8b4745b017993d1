//! Encodings of a layer of scan vectors.
//!
//! | encoding       | what it is                                                       |
//! |----------------|------------------------------------------------------------------|
//! | `Vectors`      | differences as varints: every device can read it                 |
//! | `VectorsCoded` | the same numbers, arithmetically coded                           |
//!
//! The bytes of a layer begin with the laser parameters of each class, so a layer is complete in itself. Then come runs of vectors, in
//! the order in which they are marked. `docs/encodings.md` is for firmware in other languages.
//!
//! The [`VectorDecoder`] takes the bytes in pieces and returns one vector after the other. It keeps no list of them. It treats every
//! byte as hostile: bad bytes give an error, never a panic, and no vector leaves the field.
//!
//! ```
//! use layerd_wire::encoding::{LaserParameters, MarkClass, VectorDecoder, VectorEncoder, VectorEncoding};
//!
//! let field_um = [100_000, 100_000];
//! let laser = LaserParameters { power_mw: 190_000, mark_speed_um_s: 800_000, ..LaserParameters::default() };
//! let mut bytes = Vec::new();
//! let table = [(MarkClass::Contour, laser)];
//! let mut encoder = VectorEncoder::new(VectorEncoding::Plain, field_um, &table, &mut bytes)?;
//! encoder.path(MarkClass::Contour, &[[500, 500], [560, 500], [500, 560], [500, 500]])?;
//! let sent = encoder.finish();
//!
//! let mut decoder = VectorDecoder::new(VectorEncoding::Plain, field_um, bytes.len() as u32);
//! let mut ends = Vec::new();
//! for mut piece in bytes.chunks(5) {
//!     while let Some(vector) = decoder.next(&mut piece)? {
//!         ends.push(vector.to_um);
//!     }
//! }
//! assert_eq!(ends, [[560, 500], [500, 560], [500, 500]]);
//! assert_eq!(decoder.parameters(MarkClass::Contour), Some(&laser));
//! assert_eq!(decoder.finish()?, sent);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod decoder;
mod encoder;
mod error;
mod frame;
mod layer_crc;
mod model;
mod symbol;
mod track;

pub use decoder::{Vector, VectorDecoder};
pub use encoder::{HatchLine, VectorEncoder};
pub use error::{VectorEncodeError, VectorError};
pub use frame::HatchFrame;
pub use layer_crc::LayerSum;

/// How the vectors of a layer are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VectorEncoding {
    /// [`Encoding::Vectors`](crate::message::Encoding::Vectors).
    Plain,
    /// [`Encoding::VectorsCoded`](crate::message::Encoding::VectorsCoded).
    Coded,
}

/// What a vector is marked for. Each class has laser parameters of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum MarkClass {
    /// The border of a region, and the contours inside it.
    Contour = 0,
    /// The filling of a region.
    Hatch = 1,
    /// The filling where nothing lies above.
    UpSkin = 2,
    /// The filling where nothing but powder lies below.
    DownSkin = 3,
    /// The centre line of a feature too narrow for a contour.
    Thin = 4,
    /// A feature so small that the beam stands still on it for a time.
    Point = 5,
}

impl MarkClass {
    /// All classes, in the order of their numbers.
    pub const ALL: [Self; 6] = [Self::Contour, Self::Hatch, Self::UpSkin, Self::DownSkin, Self::Thin, Self::Point];

    /// The class with a number.
    fn from_number(number: u32) -> Option<Self> {
        Self::ALL.get(number as usize).copied()
    }
}

/// What the laser and the scanner do for vectors of a class.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LaserParameters {
    /// Laser power, milliwatts.
    pub power_mw: u32,
    /// Speed while the laser is on, micrometres a second.
    pub mark_speed_um_s: u32,
    /// Speed of jumps, micrometres a second.
    pub jump_speed_um_s: u32,
    /// Distance of the focus above the powder, micrometres; below it if negative.
    pub focus_um: i32,
    /// Pause after a jump, before the laser goes on, microseconds.
    pub jump_delay_us: u32,
    /// Pause at the end of a mark, before a jump, microseconds.
    pub mark_delay_us: u32,
    /// Pause between two connected vectors, microseconds.
    pub polygon_delay_us: u32,
    /// How long the laser is on for a single point, microseconds.
    pub point_time_us: u32,
}

/// Longest side of a field, micrometres: 2.1 m. The fields of laser machines have less than 1 m. A coordinate has at most 22 bits, so
/// that the points of hatches can be computed with 64 bits.
pub const MAX_FIELD_UM: u32 = 1 << 21;

/// Most vectors of a layer. At 10,000 vectors a second they take almost four hours; and their number has 32 bits.
pub const MAX_VECTORS: u32 = 1 << 27;

/// The most bytes that a layer with this many vectors in this many runs takes, in either encoding.
///
/// Of the numbers of a vector, the coded ones of a hatch take most: three of seven learned bits, which cost at most 1.03 bits each on
/// average, and of at most 27 even bits; and a head for each 16383 vectors. A run has a head and a jump, and at most a frame and its head.
/// The table has at most 55 numbers.
pub const fn largest_vectors_bytes(vectors: u64, runs: u64) -> u64 {
    14 * vectors + 56 * runs + 320
}
