//! What a job is to print and how: the same for every kind of machine, except for [`Process`].
//!
//! ```
//! # use std::path::Path;
//! # use layerd::config::{Machine, Recipe};
//! use layerd::job::Process;
//!
//! # let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
//! let machine = Machine::load(&root.join("machines/lcd-4k-35um.toml"))?;
//! let recipe = Recipe::load(&root.join("recipes/fine.toml"))?;
//! let process = Process::new(&machine, &recipe).expect("a vat");
//! let Recipe::Dlp(dlp) = recipe else { panic!("for resin") };
//! assert!(process.layer_ms(0, None) > f64::from(dlp.layer_exposure_ms(0)), "the moves take time");
//! # Ok::<(), layerd::config::ConfigError>(())
//! ```

use std::ops::Range;

use super::cycle::{PowderPlan, VatPlan};
use crate::config::{Machine, Recipe};
use crate::device::{Passes, ScanTimes, host_us};
use crate::link::message::ExposureId;

/// A job as the engine must know it.
#[derive(Clone, Debug, PartialEq)]
pub struct JobPlan {
    /// Names the job's exposures; random, never 0.
    pub key: u64,
    /// The exposures of its layers.
    pub passes: Passes,
    /// How much faster than real time the device's clock runs ([`Machine::time_scale`]).
    pub time_scale: f64,
    /// How the machine makes a layer.
    pub process: Process,
}

/// How a machine makes a layer, by kind of machine: heights, exposures, moves and waits.
#[derive(Clone, Debug, PartialEq)]
pub enum Process {
    /// Resin in a vat, exposed from below.
    Vat(VatPlan),
    /// Powder in a bed, melted from above.
    Powder(PowderPlan),
}

impl JobPlan {
    /// The number of an exposure that a device names; `None` if the job has none such.
    pub(super) fn exposure(&self, id: &ExposureId) -> Option<u32> {
        self.passes.number(id.layer, id.pass).filter(|_| id.job == self.key)
    }

    /// Time that the machine needs for an exposure if it never waits for data, milliseconds of the device's clock.
    pub(super) fn exposure_ms(&self, exposure: u32) -> f64 {
        self.process.layer_ms(self.passes.at(exposure).layer, None)
    }

    /// Time that the machine needs for the exposures from this one on, milliseconds of the device's clock.
    pub(super) fn remaining_ms(&self, from: u32) -> f64 {
        self.process.layers_ms(self.passes.at(from).layer..self.passes.layer_count())
    }

    /// Converts a duration of the device's clock to the host's clock, microseconds.
    pub(super) fn host_us(&self, device_us: u64) -> u64 {
        host_us(device_us, self.time_scale)
    }
}

impl Process {
    /// What a machine does for a layer of a recipe; `None` if they are of different kinds.
    pub fn new(machine: &Machine, recipe: &Recipe) -> Option<Self> {
        match (machine, recipe) {
            (Machine::Dlp(machine), Recipe::Dlp(recipe)) => {
                Some(Self::Vat(VatPlan { recipe: recipe.clone(), clear_height_um: machine.clear_height_um }))
            }
            (Machine::Slm(machine), Recipe::Slm(recipe)) => {
                Some(Self::Powder(PowderPlan { recipe: recipe.clone(), recoat_ms: machine.recoat_ms }))
            }
            (Machine::Dlp(_), Recipe::Slm(_)) | (Machine::Slm(_), Recipe::Dlp(_)) => None,
        }
    }

    /// Time that the machine needs for a layer if it never waits for data, milliseconds of the device's clock. Moves count at
    /// their speed, without ramps. `times` says how long a laser takes.
    pub fn layer_ms(&self, layer: u32, times: Option<ScanTimes>) -> f64 {
        match self {
            Self::Vat(plan) => plan.layer_ms(layer),
            Self::Powder(plan) => plan.layers_ms(layer..layer + 1) + f64::from(times.map_or(0, |times| times.mark_ms)),
        }
    }

    /// Time that the machine needs for these layers if it never waits for data, milliseconds of the device's clock. How long a laser
    /// takes for them is not known and not counted.
    pub fn layers_ms(&self, layers: Range<u32>) -> f64 {
        match self {
            Self::Vat(plan) => plan.layers_ms(layers),
            Self::Powder(plan) => plan.layers_ms(layers),
        }
    }
}
