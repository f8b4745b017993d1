//! Builds the header of a surface with relief from its patches as they are written. `writer` adds it to the header of the file; `reader`
//! compares one with it.

use std::sync::Arc;

use super::maps;
use super::profile::ProfileBuilder;
use super::settings::ReliefSettings;
use crate::buildfile::model::Bounds;
use crate::buildfile::relief::{Patch, Relief, ReliefShape, Tile, whole_bounds};
use crate::solid::{Dicing, Extent, HeightMap};

/// Longest edge of the facets around which the bounds lie, micrometres: as long as the pixels of fine printers.
const BOUNDS_FACET_UM: f64 = 20.0;

/// How far those facets may be from the surface, if they are longer, micrometres: less than anybody can measure.
const BOUNDS_TOLERANCE_UM: f64 = 0.5;

/// Most patches that are held because they may reach beyond the others: 5.3 MiB. A level side with a rough surface has many.
const MAX_CANDIDATES: usize = 1 << 15;

/// Most parts of patches that are divided to find the bounds: some seconds. Only parts that may reach beyond all before are divided, so real
/// surfaces need far fewer.
const MAX_PARTS: u32 = 1 << 22;

/// A relief that is being written, or compared.
pub(super) struct ReliefBuilder {
    relief: Relief,
    profile: ProfileBuilder,
    last: Option<Patch>,
    reach: Reach,
}

/// How far patches reach.
struct Reach {
    shape: ReliefShape,
    dicing: Dicing,
    extent: Extent,
    /// Patches that may reach beyond the extent so far, and by how much at most.
    candidates: Vec<(f64, Patch)>,
    /// So many candidates are looked through for those that no longer are.
    full: usize,
}

impl ReliefBuilder {
    /// Memory of the patches that are held, bytes.
    pub(super) const BYTES: u64 = (MAX_CANDIDATES * size_of::<(f64, Patch)>()) as u64;

    /// A relief without patches, whose maps are these.
    ///
    /// # Errors
    /// A text if a map is damaged.
    pub(super) fn new(settings: &ReliefSettings, quantum_um: f64) -> Result<Self, String> {
        let decoded = settings.maps.iter().map(|map| maps::decode(&map.png, &map.header, 0).map(Arc::new));
        let decoded = decoded.collect::<Result<Vec<_>, _>>()?;
        Self::of(settings.header(), &decoded, quantum_um)
    }

    /// A relief without patches, of which nothing but its settings is known: to be compared with `stated`. [`ReliefBuilder::look_at`] tells it
    /// of one map after the other.
    ///
    /// # Errors
    /// A text if a displacement names a map that is not there.
    pub(super) fn comparing(stated: &Relief, quantum_um: f64) -> Result<Self, String> {
        let none = Bounds::EMPTY;
        let relief = Relief { bounds: none, z_reach: [i32::MAX, i32::MIN], patch_count: 0, ..stated.clone() };
        let maps = unknown_maps(&relief);
        Self::of(relief, &maps, quantum_um)
    }

    fn of(relief: Relief, maps: &[Arc<HeightMap>], quantum_um: f64) -> Result<Self, String> {
        let reach = Reach {
            shape: relief.shape(maps, quantum_um)?,
            dicing: Dicing::new([BOUNDS_FACET_UM / quantum_um; 3], BOUNDS_TOLERANCE_UM / quantum_um),
            extent: Extent::new(MAX_PARTS),
            candidates: Vec::new(),
            full: MAX_CANDIDATES / 2,
        };
        Ok(Self { relief, profile: ProfileBuilder::default(), last: None, reach })
    }

    /// Forgets the map that it knows, so that its memory is free.
    ///
    /// # Errors
    /// A text if a displacement names a map that is not there.
    pub(super) fn forget_map(&mut self, quantum_um: f64) -> Result<(), String> {
        self.reach.shape = self.relief.shape(&unknown_maps(&self.relief), quantum_um)?;
        Ok(())
    }

    /// Knows one map from now on.
    ///
    /// # Errors
    /// A text if a displacement names a map that is not there.
    pub(super) fn look_at(&mut self, number: usize, map: HeightMap, quantum_um: f64) -> Result<(), String> {
        let mut maps = unknown_maps(&self.relief);
        maps[number] = Arc::new(map);
        self.reach.shape = self.relief.shape(&maps, quantum_um)?;
        Ok(())
    }

    /// Adds a patch.
    ///
    /// # Errors
    /// A text that says how the patch is out of order, out of range, or reaches beyond its bounds of z. Then it is not added.
    pub(super) fn add(&mut self, patch: Patch) -> Result<(), String> {
        self.check(&patch)?;
        self.reach(&patch)?;
        self.count(&patch);
        Ok(())
    }

    /// Adds a patch, but for how far it reaches.
    ///
    /// # Errors
    /// A text that says how the patch is out of order or out of range. Then it is not added.
    pub(super) fn add_unplaced(&mut self, patch: &Patch) -> Result<(), String> {
        self.check(patch)?;
        self.count(patch);
        Ok(())
    }

    /// Adds how far a patch reaches, whose map it knows.
    ///
    /// # Errors
    /// A text if that is beyond its bounds of z, or takes too long to find out. Then it is not added.
    pub(super) fn reach(&mut self, patch: &Patch) -> Result<(), String> {
        self.reach.add(patch, self.relief.coarsest(patch))
    }

    fn check(&self, patch: &Patch) -> Result<(), String> {
        patch.check_range(&self.relief)?;
        if self.last.is_some_and(|last| last > *patch) {
            return Err(format!("{patch:?} comes after a higher one"));
        }
        Ok(())
    }

    fn count(&mut self, patch: &Patch) {
        let [low, high] = self.relief.z_reach;
        self.relief.z_reach = [low.min(patch.z[0]), high.max(patch.z[1])];
        self.relief.patch_count += 1;
        self.profile.add(i64::from(patch.z[0]), i64::from(patch.z[1]));
        self.last = Some(*patch);
    }

    /// Completes the bounds. Call it after the last patch, and after the last one of each map.
    ///
    /// # Errors
    /// As [`ReliefBuilder::reach`].
    pub(super) fn finish(&mut self) -> Result<(), String> {
        self.reach.drop_candidates()?;
        self.reach.settle()
    }

    /// The header of the patches added so far.
    pub(super) fn header(&self) -> Relief {
        // Its corners are in range: each lies in the box of a patch.
        let bounds = whole_bounds([self.reach.extent.low, self.reach.extent.high], 0.0).unwrap_or(Bounds::EMPTY);
        Relief { bounds, ..self.relief.clone() }
    }

    /// Their profile.
    pub(super) fn profile(&self) -> &ProfileBuilder {
        &self.profile
    }

    /// The z of their lowest point, quanta.
    pub(super) fn lowest(&self) -> f64 {
        self.reach.extent.low.z
    }
}

impl Reach {
    /// Adds a patch, whose map may be halved `coarsest` times.
    fn add(&mut self, patch: &Patch, coarsest: u8) -> Result<(), String> {
        let bounds = self.shape.bounds(patch, coarsest);
        let bounds = whole_bounds(bounds, 1.0).ok_or_else(|| format!("{patch:?} reaches beyond ±2³⁰ quanta"))?;
        if bounds.min[2] < patch.z[0] || bounds.max[2] > patch.z[1] {
            let [low, high] = [bounds.min[2], bounds.max[2]];
            return Err(format!("{patch:?} reaches from {low} to {high} quanta"));
        }
        self.shape.sides(patch).for_each(|side| self.extent.extend_to_corners(&side));
        // Room for all, so that it does not grow beyond.
        self.candidates.reserve_exact(MAX_CANDIDATES - self.candidates.len());
        self.candidates.push((0.0, *patch));
        if self.candidates.len() == self.full {
            self.drop_candidates()?;
        }
        Ok(())
    }

    /// Drops the candidates that lie within the extent, and finds out how far the others may reach.
    fn drop_candidates(&mut self) -> Result<(), String> {
        let Self { shape, extent, candidates, .. } = self;
        candidates.retain_mut(|(beyond, patch)| {
            let [low, high] = shape.bounds(patch, 0);
            *beyond = (extent.low - low).max(high - extent.high).max_element();
            *beyond > 0.0
        });
        if candidates.len() > MAX_CANDIDATES / 2 {
            self.settle()?;
        }
        self.full = (2 * self.candidates.len()).max(MAX_CANDIDATES / 2);
        Ok(())
    }

    /// Extends the bounds to all candidates: first to those that may reach farthest, so that little is left of the others.
    fn settle(&mut self) -> Result<(), String> {
        self.candidates.sort_unstable_by(|(a, _), (b, _)| b.total_cmp(a));
        for (_, patch) in self.candidates.drain(..) {
            for side in self.shape.sides(&patch) {
                self.extent.extend(&side, &self.dicing);
            }
            if self.extent.is_spent() {
                return Err(format!(
                    "the part is too rough to find its bounds in reasonable time, at {patch:?}: check its height map and the height of the \
                     displacement"
                ));
            }
        }
        Ok(())
    }
}

/// What stands for maps that are not known: single texels.
fn unknown_maps(relief: &Relief) -> Vec<Arc<HeightMap>> {
    let texel = Arc::new(HeightMap::new([1, 1], [Tile::Wrap; 2], false, vec![0]));
    vec![texel; relief.maps.len()]
}
