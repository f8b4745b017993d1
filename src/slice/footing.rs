//! Checks the lowest layers of a part before a print: would it hold to the plate? `daemon` and `layerctl check` call it.

use super::{SliceError, Slicer};
use crate::layer::Bitmap;

/// Most bottom layers that are checked: each may take as long as a large layer.
const MAX_BOTTOM_LAYERS: u32 = 16;

/// Most successive dark layers that are counted. The exact length of a longer gap is of no use.
const MAX_DARK_LAYERS: u32 = 1000;

/// Smallest distance below the plate at which the part is tested, micrometres: the lowest point of a convolution is known to within a
/// few micrometres.
const MIN_BELOW_UM: f64 = 10.0;

/// State of the lowest layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Footing {
    /// Every bottom layer has lit pixels.
    Firm,
    /// The first layers are dark: nothing would hold to the plate.
    Dark {
        /// Number of dark layers; 1000 means at least 1000.
        layers: u32,
    },
    /// Some bottom layers between others are dark: the layers above would hold to nothing.
    Gap {
        /// The first dark layer, counted from 0.
        first: u32,
        /// Number of dark layers; 1000 means at least 1000.
        layers: u32,
    },
    /// The part continues below the plate: the lowest point in the build file is too high.
    Below,
}

impl Footing {
    /// Checks the lowest layers with a slicer whose first layer is 0.
    ///
    /// # Errors
    /// As [`Slicer::next_layer`].
    pub fn of(slicer: &mut Slicer, bottom_layers: u32) -> Result<Self, SliceError> {
        let plan = slicer.plan().clone();
        let mut bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, plan.depth);
        let below_um = (plan.layer_height_um / 2.0).max(MIN_BELOW_UM);
        slicer.draw_plane(plan.z0_um - below_um, [0.0; 2], &mut bitmap)?;
        if is_lit(&bitmap) {
            return Ok(Self::Below);
        }
        let wanted = bottom_layers.clamp(1, MAX_BOTTOM_LAYERS);
        let mut dark_from = None;
        let mut looked_at = 0;
        while let Some(layer) = slicer.next_layer(&mut bitmap)? {
            looked_at = layer + 1;
            match (is_lit(&bitmap), dark_from) {
                (true, Some(0)) => return Ok(Self::Dark { layers: layer }),
                (true, Some(first)) => return Ok(Self::Gap { first, layers: layer - first }),
                (true, None) if looked_at >= wanted => return Ok(Self::Firm),
                (false, None) => dark_from = Some(layer),
                (false, Some(first)) if looked_at - first >= MAX_DARK_LAYERS => break,
                (true | false, _) => {}
            }
        }
        Ok(match dark_from {
            Some(0) => Self::Dark { layers: looked_at },
            // The part is dark up to its top, and has fewer layers than were to be checked.
            Some(first) if looked_at < plan.layer_count => Self::Gap { first, layers: looked_at - first },
            _ => Self::Firm,
        })
    }

    /// The message for the operator; `None` if the footing is firm.
    pub fn problem(self, layer_count: u32) -> Option<String> {
        let which = match self {
            Self::Firm => return None,
            Self::Below => {
                return Some(
                    "the part continues below the lowest point that its build file states: pack it again".into(),
                );
            }
            Self::Dark { layers } if layers == layer_count => "all layers are dark".to_owned(),
            Self::Dark { layers: 1 } => "the lowest layer is dark, so nothing holds to the plate".to_owned(),
            Self::Dark { layers } => format!("the lowest {layers} layers are dark, so nothing holds to the plate"),
            Self::Gap { first, layers: 1 } => {
                format!("layer {first}, counted from 0, is dark between others, so the layers above hold to nothing")
            }
            Self::Gap { first, layers } => format!(
                "layers {first} to {}, counted from 0, are dark between others, so the layers above hold to nothing",
                first + layers - 1
            ),
        };
        Some(format!(
            "{which}: the part is too thin there for these pixels, or was packed by an older layerd. Pack it again, thicker or on a \
             broader base (--rotate), or use a machine with smaller pixels"
        ))
    }
}

fn is_lit(bitmap: &Bitmap) -> bool {
    bitmap.data().iter().any(|byte| *byte != 0)
}
