//! Patches: triangles whose surface is displaced by a height map, curved, or both (Brunton and Abu Rmaileh 2021; Vlachos et al. 2001).
//!
//! A patch is never tessellated as a whole: `dice` divides it below a pixel only where it may reach some planes, and hands on flat facets
//! that are cut as those of any mesh. `grid` divides the smallest parts. `map` is the height map, `range` bounds it, and `patch` evaluates
//! a point.
//!
//! The facets of a closed surface are closed. Two patches that share an edge divide it at the same points and compute them from the same
//! numbers in the same order. Where they do not agree, at a seam, walls join both to the edge itself.

mod curve;
mod dice;
mod grid;
mod map;
mod patch;
mod range;

pub(crate) use dice::{Dicing, Extent, Window};
pub use map::{HeightMap, Tile};
pub(crate) use patch::{Lift, PatchCorner, PatchShape};
