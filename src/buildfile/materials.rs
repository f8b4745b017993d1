//! The materials of a part: which bodies are of which, and how much of a strut. `tests/materials/` packs and slices such parts.

use bincode::{Decode, Encode};

use crate::solid::{MAX_MATERIALS, WHOLE_SHARE};

/// The materials of a part.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct Materials {
    /// Their names, all different: 1 to [`Materials::MAX_COUNT`], of at most [`Materials::MAX_NAME_BYTES`] each.
    pub names: Vec<String>,
    /// The material of each body, as a place in `names`. That of a clip has no meaning.
    pub of_bodies: Vec<u8>,
    /// Which material a pixel gets where several meet.
    pub split: Split,
}

impl Materials {
    /// Most materials: more than any machine has vats or feeders.
    pub const MAX_COUNT: usize = MAX_MATERIALS;

    /// Longest name, bytes: it has to fit a line of a message.
    pub const MAX_NAME_BYTES: usize = 64;

    /// The name of what the source gives no material, if it gives others one.
    pub const UNNAMED: &'static str = "default";
}

/// Which material a pixel gets where several meet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Encode, Decode)]
pub enum Split {
    /// Each gets its share of the pixels, evenly distributed over rows, columns and layers (blue noise).
    #[default]
    Halftone,
    /// The one with the greatest share; of equal ones the first.
    Max,
}

/// How much of a strut, at `a` and at `b`, is of the material of its body, in parts of [`Shares::WHOLE`]. Between the ends it varies linearly.
/// The other parts are struts of other bodies with the same ends and radii.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shares {
    /// The share at node `a`.
    pub a: u16,
    /// The share at node `b`.
    pub b: u16,
}

impl Shares {
    /// All of it.
    pub const WHOLE: u16 = WHOLE_SHARE;
}

impl Default for Shares {
    /// All of the strut.
    fn default() -> Self {
        Self { a: Self::WHOLE, b: Self::WHOLE }
    }
}
