//! What a print begins on: the lowest layers, before anything is exposed.

use super::{SliceError, Slicer};
use crate::layer::Bitmap;

/// Bottom layers looked at, at most: they are to hold the part, and each may take the time of a large layer.
const MOST_BOTTOM_LAYERS: u32 = 16;

/// Successive dark layers looked at, at most: enough for any gap that is worth its number.
const MOST_DARK_LAYERS: u32 = 1000;

/// How far below the plate nothing may be solid, micrometres, at least: a packed convolution's lowest point is found within a
/// few micrometres.
const LEAST_BELOW_UM: f64 = 10.0;

/// What the lowest layers show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Footing {
    /// Something is lit in each bottom layer.
    Firm,
    /// So many layers, from the first on, show nothing: nothing would hold to the plate.
    Dark {
        /// How many, at least: counting ends at 1000.
        layers: u32,
    },
    /// These bottom layers show nothing between others that do: what is above would hold to nothing.
    Gap {
        /// The first of them, counted from 0.
        first: u32,
        /// How many, at least.
        layers: u32,
    },
    /// Something is solid below the plate: the build file says too high a lowest point.
    Below,
}

impl Footing {
    /// Looks at the lowest layers with a slicer whose first layer is 0.
    ///
    /// # Errors
    /// [`SliceError`] as slicing has them.
    pub fn of(slicer: &mut Slicer, bottom_layers: u32) -> Result<Self, SliceError> {
        let plan = slicer.plan().clone();
        let mut bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, plan.depth);
        let below_um = (plan.layer_height_um / 2.0).max(LEAST_BELOW_UM);
        slicer.draw_plane(plan.z0_um - below_um, [0.0; 2], &mut bitmap)?;
        if is_lit(&bitmap) {
            return Ok(Self::Below);
        }
        let wanted = bottom_layers.clamp(1, MOST_BOTTOM_LAYERS);
        let mut dark_from = None;
        let mut looked_at = 0;
        while let Some(layer) = slicer.next_layer(&mut bitmap)? {
            looked_at = layer + 1;
            match (is_lit(&bitmap), dark_from) {
                (true, Some(0)) => return Ok(Self::Dark { layers: layer }),
                (true, Some(first)) => return Ok(Self::Gap { first, layers: layer - first }),
                (true, None) if looked_at >= wanted => return Ok(Self::Firm),
                (false, None) => dark_from = Some(layer),
                (false, Some(first)) if looked_at - first >= MOST_DARK_LAYERS => break,
                (true | false, _) => {}
            }
        }
        Ok(match dark_from {
            Some(0) => Self::Dark { layers: looked_at },
            // Dark to its top, the part has fewer layers than were to be looked at.
            Some(first) if looked_at < plan.layer_count => Self::Gap { first, layers: looked_at - first },
            _ => Self::Firm,
        })
    }

    /// What an operator is told where nothing would hold; `None` where all is well.
    pub fn problem(self, layer_count: u32) -> Option<String> {
        let which = match self {
            Self::Firm => return None,
            Self::Below => {
                return Some(
                    "the part goes on below the height at which its build file says that it begins: pack it again"
                        .into(),
                );
            }
            Self::Dark { layers } if layers == layer_count => "all layers are dark".to_owned(),
            Self::Dark { layers: 1 } => "the lowest layer is dark, so nothing holds to the plate".to_owned(),
            Self::Dark { layers } => format!("the lowest {layers} layers are dark, so nothing holds to the plate"),
            Self::Gap { first, layers: 1 } => {
                format!("layer {first}, counted from 0, is dark between others, so what is above holds to nothing")
            }
            Self::Gap { first, layers } => format!(
                "layers {first} to {}, counted from 0, are dark between others, so what is above holds to nothing",
                first + layers - 1
            ),
        };
        Some(format!(
            "{which}: the part is thinner there than pixels show, or an older layerd packed it. Pack it again, thicker or standing \
             on something broader (--rotate), or choose a machine with finer pixels"
        ))
    }
}

fn is_lit(bitmap: &Bitmap) -> bool {
    bitmap.data().iter().any(|byte| *byte != 0)
}
