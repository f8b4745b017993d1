//! The layers of a part as scan vectors, one after the other. `part.rs` encodes them, and `layerctl slice` writes them.

use super::PartError;
use crate::layer::Vectors;
use crate::slice::scan::{self, Contours, Fill, LayerRegions, ScanCounts, ScanSettings};
use crate::slice::{FieldSource, SlicePlan};
use crate::stream::MemoryBudget;

/// Computes the scan vectors of layers, in ascending order.
pub struct ScannedLayers {
    contours: Contours,
    fill: Fill,
    /// `None` if the filling does not depend on the layers above and below.
    neighbours: Option<Neighbours>,
    vectors: Vectors,
}

/// Layers next to each other, for skins.
struct Neighbours {
    /// The layer before the next one; `None` at the first.
    below: Option<LayerRegions>,
    /// The next layer; `None` after the last.
    here: Option<LayerRegions>,
}

/// A layer of scan vectors.
#[derive(Debug)]
pub struct ScannedLayer<'a> {
    /// Its number.
    pub layer: u32,
    /// What is marked.
    pub vectors: &'a Vectors,
    /// What became of its regions.
    pub counts: ScanCounts,
}

impl ScannedLayers {
    /// Layers from `first` on. What computing them takes is charged to `budget`.
    pub(super) fn new(
        bodies: Vec<FieldSource>,
        plan: SlicePlan,
        settings: &ScanSettings,
        threads: usize,
        first: u32,
        budget: &MemoryBudget,
    ) -> Result<Self, PartError> {
        let has_skins = settings.has_skins();
        // The skins of the first layer depend on the layer below it.
        let begin = first.saturating_sub(u32::from(has_skins));
        let mut contours = Contours::of_sources(bodies, plan, settings.simplify_tolerance_um, threads, begin, budget)?;
        let fill = Fill::new(settings.clone(), threads, budget)?;
        let neighbours = match has_skins {
            true => {
                let below = if first > 0 { contours.next_layer()? } else { None };
                Some(Neighbours { below, here: contours.next_layer()? })
            }
            false => None,
        };
        Ok(Self { contours, fill, neighbours, vectors: Vectors::default() })
    }

    /// The next layer; `None` after the last. Its vectors are in memory at once; a print takes [`ScannedLayers::next_groups`] instead.
    ///
    /// # Errors
    /// [`PartError`] if it cannot be computed, or is too complex for the memory budget.
    pub fn next_layer(&mut self) -> Result<Option<ScannedLayer<'_>>, PartError> {
        let Some(next) = self.step()? else { return Ok(None) };
        self.vectors.clear();
        let (layer, regions) = (next.here.layer(), next.here.regions());
        let counts = self.fill.layer(layer, regions, next.neighbours(), &mut self.vectors)?;
        self.keep(next);
        Ok(Some(ScannedLayer { layer, vectors: &self.vectors, counts }))
    }

    /// Hands the vectors of the next layer on in groups, in the order in which they are marked. Returns its number and what became of its
    /// regions; `None` after the last.
    ///
    /// # Errors
    /// As [`ScannedLayers::next_layer`], or that of `take`.
    pub fn next_groups(
        &mut self,
        take: impl FnMut(&Vectors) -> Result<(), PartError>,
    ) -> Result<Option<(u32, ScanCounts)>, PartError> {
        let Some(next) = self.step()? else { return Ok(None) };
        let layer = next.here.layer();
        let counts = self.fill.groups(layer, next.here.regions(), next.neighbours(), take)?;
        self.keep(next);
        Ok(Some((layer, counts)))
    }

    /// The regions of the next layer, and of those next to it.
    fn step(&mut self) -> Result<Option<Step>, PartError> {
        let next = self.contours.next_layer()?;
        let (below, here, above) = match &mut self.neighbours {
            Some(neighbours) => (neighbours.below.take(), neighbours.here.take(), next),
            None => (None, next, None),
        };
        Ok(here.map(|here| Step { below, here, above }))
    }

    fn keep(&mut self, Step { here, above, .. }: Step) {
        if let Some(neighbours) = &mut self.neighbours {
            *neighbours = Neighbours { below: Some(here), here: above };
        }
    }
}

/// The regions of a layer, and of those next to it if the filling depends on them.
struct Step {
    below: Option<LayerRegions>,
    here: LayerRegions,
    above: Option<LayerRegions>,
}

impl Step {
    fn neighbours(&self) -> scan::Neighbours<'_> {
        let [above, below] = [&self.above, &self.below].map(|layer| layer.as_ref().map(LayerRegions::regions));
        scan::Neighbours { above, below }
    }
}
