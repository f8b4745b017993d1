//! Builds the header of a surface with relief from its patches as they are written. `writer` adds it to the header of the file; `reader`
//! compares one with it.

use std::sync::Arc;

use super::maps;
use super::profile::ProfileBuilder;
use super::settings::ReliefSettings;
use crate::buildfile::model::Bounds;
use crate::buildfile::relief::{Patch, Relief, ReliefShape, whole_bounds};
use crate::solid::{Dicing, Extent};

/// Longest edge of the facets around which the bounds lie, micrometres: as long as the pixels of fine printers.
const BOUNDS_FACET_UM: f64 = 20.0;

/// How far those facets may be from the surface, if they are longer, micrometres: less than anybody can measure.
const BOUNDS_TOLERANCE_UM: f64 = 0.5;

/// Most patches that are held because they may reach beyond the others: 5.3 MiB. A level side with a rough surface has many.
const MAX_CANDIDATES: usize = 1 << 15;

/// A relief that is being written, or compared.
pub(super) struct ReliefBuilder {
    relief: Relief,
    shape: ReliefShape,
    dicing: Dicing,
    profile: ProfileBuilder,
    extent: Extent,
    /// Patches that may reach beyond the extent so far, which holds corners only, and by how much at most.
    candidates: Vec<(f64, Patch)>,
    /// So many candidates are looked through for those that no longer are.
    full: usize,
    last: Option<Patch>,
}

impl ReliefBuilder {
    /// A relief without patches, whose maps are these.
    ///
    /// # Errors
    /// A text if a map is damaged.
    pub(super) fn new(settings: &ReliefSettings, quantum_um: f64) -> Result<Self, String> {
        let decoded = settings.maps.iter().map(|map| maps::decode(&map.png, &map.header, 0).map(Arc::new));
        let decoded = decoded.collect::<Result<Vec<_>, _>>()?;
        let relief = settings.header();
        let shape = relief.shape(&decoded, quantum_um)?;
        Ok(Self {
            relief,
            shape,
            dicing: Dicing::new([BOUNDS_FACET_UM / quantum_um; 3], BOUNDS_TOLERANCE_UM / quantum_um),
            profile: ProfileBuilder::default(),
            extent: Extent::EMPTY,
            candidates: Vec::new(),
            full: MAX_CANDIDATES / 2,
            last: None,
        })
    }

    /// Adds a patch.
    ///
    /// # Errors
    /// A text that says how the patch is out of order, out of range, or reaches beyond its bounds of z. Then it is not added.
    pub(super) fn add(&mut self, patch: Patch) -> Result<(), String> {
        patch.check_range(&self.relief)?;
        if self.last.is_some_and(|last| last > patch) {
            return Err(format!("{patch:?} comes after a higher one"));
        }
        let bounds = self.shape.bounds(&patch, self.relief.coarsest(&patch));
        let bounds = whole_bounds(bounds, 1.0).ok_or_else(|| format!("{patch:?} reaches beyond ±2³⁰ quanta"))?;
        if bounds.min[2] < patch.z[0] || bounds.max[2] > patch.z[1] {
            let [low, high] = [bounds.min[2], bounds.max[2]];
            return Err(format!("{patch:?} reaches from {low} to {high} quanta"));
        }
        let [low, high] = self.relief.z_reach;
        self.relief.z_reach = [low.min(patch.z[0]), high.max(patch.z[1])];
        self.relief.patch_count += 1;
        self.profile.add(i64::from(patch.z[0]), i64::from(patch.z[1]));
        self.shape.sides(&patch).for_each(|side| self.extent.extend_to_corners(&side));
        self.candidates.push((0.0, patch));
        if self.candidates.len() == self.full {
            self.drop_candidates();
        }
        self.last = Some(patch);
        Ok(())
    }

    /// Drops the candidates that lie within the extent, and finds out how far the others may reach.
    fn drop_candidates(&mut self) {
        let Self { shape, extent, candidates, .. } = self;
        candidates.retain_mut(|(beyond, patch)| {
            let [low, high] = shape.bounds(patch, 0);
            *beyond = (extent.low - low).max(high - extent.high).max_element();
            *beyond > 0.0
        });
        if candidates.len() > MAX_CANDIDATES / 2 {
            self.settle();
        }
        self.full = (2 * self.candidates.len()).max(MAX_CANDIDATES / 2);
    }

    /// Completes the bounds. Call it after the last patch.
    pub(super) fn finish(&mut self) {
        self.drop_candidates();
        self.settle();
    }

    /// Extends the bounds to all candidates: first to those that may reach farthest, so that little is left of the others.
    fn settle(&mut self) {
        self.candidates.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        for (_, patch) in self.candidates.drain(..) {
            for side in self.shape.sides(&patch) {
                self.extent.extend(&side, &self.dicing);
            }
        }
    }

    /// The header of the patches added so far.
    pub(super) fn header(&self) -> Relief {
        // Its corners are in range: each lies in the box of a patch.
        let bounds = whole_bounds([self.extent.low, self.extent.high], 0.0).unwrap_or(Bounds::EMPTY);
        Relief { bounds, ..self.relief.clone() }
    }

    /// Their profile.
    pub(super) fn profile(&self) -> &ProfileBuilder {
        &self.profile
    }

    /// The z of their lowest point, quanta.
    pub(super) fn lowest(&self) -> f64 {
        self.extent.low.z
    }
}
