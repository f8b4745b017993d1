//! What a surface consists of: triangles, which are cut as they are, and patches, which are divided first. `sweep` and `brush` are the same
//! for both. `tests/surface/` and `tests/relief/` test them.

use std::fmt::Debug;

use crate::buildfile::{MAP_DECODING_BYTES, MapHeader, Patch, QUANTUM_FRACTIONS, Relief, ReliefShape, Triangle};
use crate::slice::body::source::{BodyPrimitive, ChunkSource};
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{Dicing, Facet, HeightMap, Window};

/// Longest edge of the facets of a patch before they are displaced, in pixels, and in layers along z.
const FACET_PX: f64 = 1.0;

/// How far a longer facet may be from what it stands for, in the smallest of pixel pitch and layer height.
const FACET_TOLERANCE: f64 = 0.04;

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

    /// Hands on all facets that matter in a window, and maybe others.
    fn facets(kept: &Self::Kept, cutter: &Self::Cutter, window: Window, take: impl FnMut(&Facet));
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

    fn facets(kept: &Facet, _cutter: &(), _window: Window, mut take: impl FnMut(&Facet)) {
        take(kept);
    }
}

/// A coordinate in quanta, exact.
fn quanta(at: i64) -> f64 {
    at as f64 / QUANTUM_FRACTIONS as f64
}

/// What patches are divided with.
pub(in crate::slice::body) struct Dicer {
    shape: ReliefShape,
    dicing: Dicing,
}

/// How often a map is halved for the pictures of a plan.
fn level(plan: &SlicePlan, map: &MapHeader) -> u8 {
    let [x_um, y_um] = plan.raster.pixel_um;
    map.level(x_um.min(y_um))
}

impl Element for Patch {
    type Kept = Self;
    type Cutter = Dicer;

    fn cutter(source: &dyn ChunkSource<Self>, plan: &SlicePlan) -> Result<Dicer, SliceError> {
        let (relief, quantum_um): (&Relief, _) = (source.header(), source.quantum_um());
        let maps = if relief.maps.is_empty() {
            Vec::new()
        } else {
            source.read_maps(&|map| level(plan, map)).map_err(SliceError::Source)?
        };
        let shape = relief.shape(&maps, quantum_um).map_err(SliceError::Damaged)?;
        let [x_um, y_um] = plan.raster.pixel_um;
        let voxel = [x_um, y_um, plan.layer_height_um].map(|um| um / quantum_um);
        let tolerance = FACET_TOLERANCE * voxel[0].min(voxel[1]).min(voxel[2]);
        let dicing = Dicing::new(voxel.map(|side| side * FACET_PX), tolerance);
        Ok(Dicer { shape, dicing })
    }

    fn cutter_bytes(source: &dyn ChunkSource<Self>, plan: &SlicePlan) -> u64 {
        let maps = &source.header().maps;
        let decoded = maps.iter().map(|map| HeightMap::bytes(map.size_at(level(plan, map))));
        // One map at a time is read and decoded.
        let reading = maps.iter().map(|map| u64::from(map.bytes) + MAP_DECODING_BYTES).max().unwrap_or(0);
        decoded.fold(reading, u64::saturating_add)
    }

    fn keep(&self, cutter: &Dicer) -> Result<(Self, Extent), String> {
        let [low, high] = cutter.shape.bounds(self, 0);
        let [from, to] = self.z.map(f64::from);
        if low.z < from || high.z > to {
            return Err(format!("{self:?} reaches from {} to {} quanta", low.z, high.z));
        }
        Ok((*self, Extent { low: from, y: [low.y, high.y] }))
    }

    fn high(kept: &Self) -> f64 {
        f64::from(kept.z[1])
    }

    fn facets(kept: &Self, cutter: &Dicer, window: Window, mut take: impl FnMut(&Facet)) {
        for side in cutter.shape.sides(kept) {
            side.facets(&cutter.dicing, window, &mut take);
        }
    }
}
