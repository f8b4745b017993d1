//! Patches as elements of a surface. They are divided into facets (`solid/relief/`), which `slabs` keeps for some layers. `tests/relief/`
//! tests them.

use std::ops::Range;

use super::active::Active;
use super::element::{Element, Extent};
use super::slabs::{Patches, Slabs};
use crate::buildfile::{MapHeader, Patch, Relief, ReliefShape, map_decoding_bytes};
use crate::slice::body::source::ChunkSource;
use crate::slice::{SliceError, SlicePlan};
use crate::solid::{Dicing, Facet, HeightMap, Window};

/// Longest edge of the facets of a patch before they are displaced, in pixels, and in layers along z.
const FACET_PX: f64 = 1.0;

/// How far a longer facet may be from what it stands for, in the smallest of pixel pitch and layer height.
const FACET_TOLERANCE: f64 = 0.04;

/// What patches are divided with.
pub(in crate::slice::body) struct Dicer {
    shape: ReliefShape,
    dicing: Dicing,
    slabs: Slabs,
}

impl Dicer {
    /// Hands on the facets of a patch that a window meets, until `take` returns false. Returns whether it did not.
    pub(super) fn dice(&self, patch: &Patch, window: Window, mut take: impl FnMut(&Facet) -> bool) -> bool {
        self.shape.sides(patch).all(|side| side.facets(&self.dicing, window, &mut take))
    }
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
        Ok(Dicer { shape, dicing, slabs: Slabs::new(plan, quantum_um) })
    }

    fn cutter_bytes(source: &dyn ChunkSource<Self>, plan: &SlicePlan) -> u64 {
        let maps = &source.header().maps;
        let decoded = maps.iter().map(|map| HeightMap::bytes(map.size_at(level(plan, map))));
        // One map at a time is read and decoded. Slabs are made when that is done.
        let reading = maps.iter().map(|map| u64::from(map.bytes) + map_decoding_bytes(map.size[0])).max().unwrap_or(0);
        decoded.fold(reading.max(Slabs::bytes(plan)), u64::saturating_add)
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

    fn facets(active: &Active<Self>, cutter: &Dicer, z: f64, rows: Range<i64>, take: impl FnMut(&Facet) -> bool) {
        cutter.slabs.facets(Patches { active, dicer: cutter }, z, rows, take);
    }
}
