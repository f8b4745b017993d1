//! About how much resin the part of a job takes, as it is kept with the job in the spool.
//! `printer/sampler.rs` makes it; `layerctl jobs` shows it.

use std::io;

use serde::{Deserialize, Serialize};

use crate::disk;
use crate::job::JobDirectory;

/// Slabs of a part with a volume of their own: the share that is printed is then known to about a sixtieth.
const SLABS: usize = 64;
/// The note of an estimate is shorter: 64 numbers of some twenty digits.
const MAX_NOTE_BYTES: u64 = 4 << 10;

/// About how much resin a part takes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Resin {
    /// Volume below the upper end of each of [`SLABS`] equal slabs of the part's height, millilitres.
    below_ml: Vec<f64>,
}

impl Resin {
    /// Reads the estimate of a job; `None` if there is none, or none that makes sense. The latter is logged. The part of a job
    /// that is not over is sampled again then.
    pub(crate) fn load(job: &JobDirectory) -> Option<Self> {
        let read = disk::read_small(&job.resin(), MAX_NOTE_BYTES).and_then(|note| Self::parse(&note));
        read.inspect_err(|error| {
            if error.kind() != io::ErrorKind::NotFound {
                let note = job.resin();
                tracing::warn!(job = job.id, "the note of its resin, {}, is not used: {error}", note.display());
            }
        })
        .ok()
    }

    fn parse(note: &[u8]) -> io::Result<Self> {
        let resin: Self = serde_json::from_slice(note)?;
        let ascends = resin.below_ml.is_sorted() && resin.below_ml.iter().all(|ml| ml.is_finite() && *ml >= 0.0);
        if ascends && resin.below_ml.len() == SLABS {
            return Ok(resin);
        }
        Err(io::Error::other(format!("it does not hold {SLABS} ascending volumes")))
    }

    /// Notes the estimate with its job.
    ///
    /// # Errors
    /// The note cannot be written; an earlier one is unchanged then.
    pub(crate) fn save(&self, job: &JobDirectory) -> io::Result<()> {
        disk::replace(&job.resin(), &serde_json::to_vec(self)?)
    }

    /// Adds up slabs of equal height, mm³ each, the lowest first.
    pub(crate) fn of_slabs(slabs_mm3: &[f64]) -> Self {
        let below_ml = |slab: usize| {
            // In slabs of those given.
            let height = slab as f64 * slabs_mm3.len() as f64 / SLABS as f64;
            let whole = height as usize;
            let rest_mm3 = slabs_mm3.get(whole).map_or(0.0, |slab_mm3| slab_mm3 * height.fract());
            (slabs_mm3[..whole].iter().sum::<f64>() + rest_mm3) / 1000.0
        };
        Self { below_ml: (1..=SLABS).map(below_ml).collect() }
    }

    /// What the whole part takes, millilitres.
    pub(crate) fn total_ml(&self) -> f64 {
        self.below_ml.last().copied().unwrap_or(0.0)
    }

    /// What the lowest `layers` of `total` layers take, millilitres.
    pub(crate) fn layers_ml(&self, layers: u32, total: u32) -> f64 {
        let height = f64::from(layers.min(total)) * self.below_ml.len() as f64 / f64::from(total.max(1));
        let whole = height as usize;
        let below_ml =
            |slabs: usize| slabs.checked_sub(1).and_then(|last| self.below_ml.get(last)).copied().unwrap_or(0.0);
        match self.below_ml.get(whole) {
            Some(above_ml) => below_ml(whole) + (above_ml - below_ml(whole)) * height.fract(),
            None => self.total_ml(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_follows_the_parts_height() {
        // A foot of 100 slabs of 3 mm³ under 100 of 1 mm³.
        let slabs: Vec<f64> = (0..200).map(|slab| if slab < 100 { 3.0 } else { 1.0 }).collect();
        let resin = Resin::of_slabs(&slabs);
        let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-9, "{found} for {expected}");
        near(resin.total_ml(), 0.4);
        for (layers, ml) in [(0, 0.0), (7, 0.042), (25, 0.15), (50, 0.3), (75, 0.35), (100, 0.4), (101, 0.4)] {
            near(resin.layers_ml(layers, 100), ml);
        }
        near(resin.layers_ml(0, 0), 0.0);
        // As many slabs as are kept, and fewer than are kept.
        near(Resin::of_slabs(&[1.0; 64]).layers_ml(1, 2), 0.032);
        near(Resin::of_slabs(&[5.0; 3]).layers_ml(1, 3), 0.005);
    }
}
