//! The layers of a part as scan vectors, one after the other. `layerctl slice` takes them from here.

use super::PartError;
use crate::layer::Vectors;
use crate::slice::SlicePlan;
use crate::slice::scan::{Contours, Fill, LayerRegions, ScanCounts};

/// Computes the scan vectors of layers, in ascending order.
pub struct ScannedLayers {
    contours: Contours,
    fill: Fill,
    /// Whether the filling depends on the layers above and below.
    has_skins: bool,
    /// The layer before the next one, the next one, and the one after it, as far as they are there and needed.
    below: Option<LayerRegions>,
    here: Option<LayerRegions>,
    above: Option<LayerRegions>,
    /// The first layer that was asked for: one before it may be computed for its skins.
    first: u32,
    vectors: Vectors,
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
    /// The layer that `contours` must begin with, so that the skins of layer `first` are known.
    pub(super) fn first_contour(first: u32, has_skins: bool) -> u32 {
        first.saturating_sub(u32::from(has_skins))
    }

    /// Layers from `first` on; `contours` begins with [`ScannedLayers::first_contour`].
    pub(super) fn new(mut contours: Contours, fill: Fill, first: u32, has_skins: bool) -> Result<Self, PartError> {
        let below = match has_skins && first > 0 {
            true => contours.next_layer()?,
            false => None,
        };
        let here = contours.next_layer()?;
        Ok(Self { contours, fill, has_skins, below, here, above: None, first, vectors: Vectors::default() })
    }

    /// The next layer; `None` after the last.
    ///
    /// # Errors
    /// [`PartError`] if it cannot be computed, or is too complex for the memory budget.
    pub fn next_layer(&mut self) -> Result<Option<ScannedLayer<'_>>, PartError> {
        if self.has_skins {
            self.above = self.contours.next_layer()?;
        }
        let Some(here) = self.here.take() else { return Ok(None) };
        debug_assert!(here.layer() >= self.first);
        let regions = |layer: &Option<LayerRegions>| layer.as_ref().map(|layer| layer.regions().to_vec());
        self.vectors.clear();
        let (above, below) = (regions(&self.above), regions(&self.below));
        let counts =
            self.fill.layer(here.layer(), here.regions(), above.as_deref(), below.as_deref(), &mut self.vectors)?;
        let layer = here.layer();
        if self.has_skins {
            self.below = Some(here);
            self.here = self.above.take();
        } else {
            drop(here);
            self.here = self.contours.next_layer()?;
        }
        Ok(Some(ScannedLayer { layer, vectors: &self.vectors, counts }))
    }

    /// The grid and planes of the layers.
    pub fn plan(&self) -> &SlicePlan {
        self.contours.plan()
    }
}
