//! What a surface consists of: triangles, which are cut as they are, and patches (`patches`), which are divided first. `sweep` and `brush`
//! are the same for both. `tests/surface/` and `tests/relief/` test them.

use std::fmt::Debug;
use std::ops::Range;

use super::active::Active;
use crate::buildfile::{QUANTUM_FRACTIONS, Triangle};
use crate::slice::body::source::{BodyPrimitive, ChunkSource};
use crate::slice::{SliceError, SlicePlan};
use crate::solid::Facet;

/// Where an element matters, quanta.
#[derive(Clone, Copy, Debug)]
pub(in crate::slice::body) struct Extent {
    pub(super) low: f64,
    pub(super) y: [f64; 2],
}

/// A triangle or a patch.
pub(in crate::slice::body) trait Element: BodyPrimitive {
    /// The element while planes cut it.
    type Kept: Copy + Debug + Send + Sync;

    /// What all elements of a body are cut with.
    type Cutter: Send + Sync;

    /// What is needed to cut the elements of a source for the pictures of a plan.
    ///
    /// # Errors
    /// [`SliceError`] if it cannot be read.
    fn cutter(source: &dyn ChunkSource<Self>, plan: &SlicePlan) -> Result<Self::Cutter, SliceError>;

    /// Memory of that, bytes, also while it is read.
    fn cutter_bytes(source: &dyn ChunkSource<Self>, plan: &SlicePlan) -> u64;

    /// The element to be kept, and where it matters.
    ///
    /// # Errors
    /// A text if it reaches beyond its range of z.
    fn keep(&self, cutter: &Self::Cutter) -> Result<(Self::Kept, Extent), String>;

    /// Height of its highest point.
    fn high(kept: &Self::Kept) -> f64;

    /// Hands on all facets of the active elements that a plane at `z` cuts in some rows, each once, and maybe others; until `take` returns
    /// false. Planes never move down.
    fn facets(
        active: &Active<Self::Kept>,
        cutter: &Self::Cutter,
        z: f64,
        rows: Range<i64>,
        take: impl FnMut(&Facet) -> bool,
    );
}

impl Element for Triangle {
    type Kept = Facet;
    type Cutter = ();

    fn cutter(_source: &dyn ChunkSource<Self>, _plan: &SlicePlan) -> Result<(), SliceError> {
        Ok(())
    }

    fn cutter_bytes(_source: &dyn ChunkSource<Self>, _plan: &SlicePlan) -> u64 {
        0
    }

    fn keep(&self, _cutter: &()) -> Result<(Facet, Extent), String> {
        let [a, b, c] = &self.corners;
        let corner = |[x, y, z]: &[i64; 3]| [quanta(*x), quanta(*y), quanta(*z)];
        let facet = [corner(a), corner(b), corner(c)];
        let [a, b, c] = [facet[0][1], facet[1][1], facet[2][1]];
        let extent = Extent { low: facet[0][2], y: [a.min(b).min(c), a.max(b).max(c)] };
        Ok((facet, extent))
    }

    fn high(kept: &Facet) -> f64 {
        // The first corner is the lowest.
        kept[1][2].max(kept[2][2])
    }

    fn facets(active: &Active<Facet>, _cutter: &(), _z: f64, rows: Range<i64>, take: impl FnMut(&Facet) -> bool) {
        // Stops at the first that is not taken.
        active.reaching(rows).all(take);
    }
}

/// A coordinate in quanta, exact.
fn quanta(at: i64) -> f64 {
    at as f64 / QUANTUM_FRACTIONS as f64
}
