//! Solids that triangles enclose. A plane cuts the triangles in directed segments (`section`), the segments cross rows of pixels (`rows`),
//! and a point is solid if its winding number is above 0. So overlapping pieces are one solid, and a surface that is turned inside out
//! within another is a cavity.
//!
//! Neighbouring triangles share the two ends of an edge, and each crossing is computed from these two alone, in the same order. So segments
//! meet exactly, and no row is crossed an odd number of times: a closed surface has no streaks, however small or flat its triangles are.

mod counts;
mod distance;
mod rows;
mod section;

pub(crate) use distance::FieldRows;
pub(crate) use rows::{Crossings, Resolution, set_bits};
pub(crate) use section::{Facet, SectionPlane, Segment};
