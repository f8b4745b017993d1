//! Patches: triangles whose surface is displaced by a height map, curved, or both (Brunton and Abu Rmaileh 2021; Vlachos et al. 2001).
//!
//! A plane cuts a patch without the patch ever being tessellated as a whole: `dice` divides it below a pixel only where it may reach the
//! plane, and hands on flat facets that are cut as those of any mesh. Nothing is kept. `map` is the height map, `range` bounds it, and
//! `patch` evaluates a point.
//!
//! The facets of a closed surface are closed. Two patches that share an edge divide it at the same points and compute them from the same
//! numbers in the same order. Where they do not agree, at a seam, walls join both to the edge itself.

mod curve;
mod dice;
mod map;
mod patch;
mod range;

pub(crate) use dice::{Dicing, Extent, Window};
pub use map::{HeightMap, Tile};
pub(crate) use patch::{Lift, PatchCorner, PatchShape};
