//! Joins the struts of several materials into one solid, and says which material each pixel gets.
//!
//! Each material has a strip of its own. [`JoinedShape::join`] makes one strip of them all, which becomes pixels or a field like any other.
//! Bits need no such strip: `owner` finds them eight by eight, and chooses their materials by weight, with the thresholds of `halftone`, or the greatest.
//!
//! `slice/body/lattice/joined/` draws with it; `tests/materials/` compares it with the formulas.

mod fields;
mod halftone;
mod owner;
mod shared_union;

use super::{FieldShape, InstructionSet, PixelShape};
pub(crate) use halftone::Halftone;
pub(crate) use owner::{Rule, Stretch as JoinedStretch};
pub(crate) use shared_union::SharedUnion;

/// Most materials: more than any machine has vats or feeders.
pub(crate) const MAX_MATERIALS: usize = 8;

/// How the fields of several materials become one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Joining {
    /// Their sum.
    Sum,
    /// Elliptic arcs, where each field exceeds its share of the isovalue: see [`elliptic`](crate::solid::reference::elliptic).
    Elliptic([f32; MAX_MATERIALS]),
}

impl Joining {
    /// Elliptic arcs of up to [`MAX_MATERIALS`] materials. `least` is that of the first and of the second; if there are more, they are equal.
    pub(crate) fn elliptic([first, others]: [f64; 2]) -> Self {
        let mut least = [others as f32; MAX_MATERIALS];
        least[0] = first as f32;
        Self::Elliptic(least)
    }
}

/// A shape whose struts may be of several materials. The number of materials is that of `cells`.
pub(crate) trait JoinedShape: PixelShape {
    /// Joins cells of all materials, of the same pixels. `cells` and `out` have the same length.
    fn join(instructions: InstructionSet, joining: &Joining, cells: &[&[Self::Cell]], out: &mut [Self::Cell]);

    /// Which of eight pixels from `first` on are solid; the first is the highest bit.
    fn solid(joining: &Joining, cells: &[&[Self::Cell]], first: usize) -> u8;

    /// The weights of all materials at eight pixels from `first` on, at least 0.
    fn weigh(cells: &[&[Self::Cell]], first: usize, weights: &mut [[f32; 8]]);
}

/// A shape whose materials can be drawn as fields.
pub(crate) trait FieldOfMaterial: JoinedShape + FieldShape {
    /// Lowers joined cells to where member `only` has the greatest field.
    fn restrict(cells: &[&[Self::Cell]], only: usize, joined: &mut [Self::Cell]);
}
