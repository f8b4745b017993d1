//! A recipe for DLP machines. `config/recipes/default.toml` explains its keys.

use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::config::{OutOfRange, within};
use crate::layer::Depth;

/// A recipe for a DLP machine: exposure of the layers and moves of the plate.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DlpRecipe {
    /// For people.
    pub name: String,
    /// Read before, to know which keys there are. A recipe that names none is for a DLP machine.
    #[serde(rename = "kind", default)]
    _kind: IgnoredAny,
    /// Layer height, micrometres.
    pub layer_height_um: f64,
    /// Exposure of a normal layer, milliseconds.
    pub exposure_ms: u32,
    /// Exposure of a bottom layer, milliseconds.
    pub bottom_exposure_ms: u32,
    /// Number of bottom layers.
    pub bottom_layers: u32,
    /// Layers over which the exposure falls linearly from bottom to normal.
    #[serde(default)]
    pub transition_layers: u32,
    /// How far the plate rises after a layer, micrometres.
    pub lift_height_um: u32,
    /// Speed of the lift, micrometres a second.
    pub lift_speed_um_s: u32,
    /// Speed of the return move, micrometres a second.
    pub retract_speed_um_s: u32,
    /// Wait after the plate has arrived, milliseconds, so that the resin comes to rest. `wait_before_exposure_ms` follows.
    #[serde(default)]
    pub light_off_delay_ms: u32,
    /// Wait before light, milliseconds.
    #[serde(default)]
    pub wait_before_exposure_ms: u32,
    /// Wait after light, before the lift, milliseconds.
    #[serde(default)]
    pub wait_after_exposure_ms: u32,
    /// Wait at the top of the lift, milliseconds.
    #[serde(default)]
    pub wait_after_lift_ms: u32,
    /// Light power, 1 to 255.
    #[serde(default = "full_power")]
    pub light_pwm: u8,
    /// Whether edges are smoothed with 8-bit grey.
    #[serde(default)]
    pub antialias: bool,
}

fn full_power() -> u8 {
    255
}

impl DlpRecipe {
    pub(super) fn check(&self) -> Vec<OutOfRange> {
        // No resin needs an exposure of ten minutes. Moves are limited so that a typing error cannot take hours.
        [
            within("layer_height_um", self.layer_height_um, 1.0, 1000.0),
            within("exposure_ms", self.exposure_ms, 1, 600_000),
            within("bottom_exposure_ms", self.bottom_exposure_ms, 1, 600_000),
            within("bottom_layers", self.bottom_layers, 0, 10_000),
            within("transition_layers", self.transition_layers, 0, 10_000),
            within("lift_height_um", self.lift_height_um, 0, 100_000),
            within("lift_speed_um_s", self.lift_speed_um_s, 10, 1_000_000),
            within("retract_speed_um_s", self.retract_speed_um_s, 10, 1_000_000),
            within("light_off_delay_ms", self.light_off_delay_ms, 0, 600_000),
            within("wait_before_exposure_ms", self.wait_before_exposure_ms, 0, 600_000),
            within("wait_after_exposure_ms", self.wait_after_exposure_ms, 0, 600_000),
            within("wait_after_lift_ms", self.wait_after_lift_ms, 0, 600_000),
            within("light_pwm", self.light_pwm, 1, 255),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// Bits a pixel of its layers.
    pub fn depth(&self) -> Depth {
        if self.antialias { Depth::Grey } else { Depth::Bit }
    }

    /// Exposure of a layer, milliseconds: bottom layers, then a linear transition, then normal layers.
    pub fn layer_exposure_ms(&self, layer: u32) -> u32 {
        let Some(after_bottom) = layer.checked_sub(self.bottom_layers) else {
            return self.bottom_exposure_ms;
        };
        if after_bottom >= self.transition_layers {
            return self.exposure_ms;
        }
        // Layer i of n transition layers lies (i + 1)/(n + 1) of the way from bottom to normal.
        let (step, steps) = (i64::from(after_bottom) + 1, i64::from(self.transition_layers) + 1);
        let (bottom, normal) = (i64::from(self.bottom_exposure_ms), i64::from(self.exposure_ms));
        u32::try_from(bottom + (normal - bottom) * step / steps).unwrap_or(self.exposure_ms)
    }
}
