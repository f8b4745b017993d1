//! The lowest solid point of a union, exact. `writer` and `reader` pass all struts through it.

use crate::buildfile::model::Strut;
use crate::solid::lowest_z;

/// The lowest solid point of the struts added so far, quanta.
#[derive(Clone, Copy, Debug)]
pub(super) struct LowestOfUnion(f64);

impl Default for LowestOfUnion {
    /// No strut.
    fn default() -> Self {
        Self(f64::INFINITY)
    }
}

impl LowestOfUnion {
    /// Adds a strut.
    pub(super) fn add(&mut self, strut: &Strut) {
        // Most struts of a part are far above its bottom: a cheap test first.
        if f64::from(strut.a[2]) - f64::from(strut.radius_a.max(strut.radius_b)) < self.0 {
            self.0 = self.0.min(lowest_z(&strut.beam()));
        }
    }

    /// The point, micrometres.
    pub(super) fn um(self, quantum_um: f64) -> f64 {
        self.0 * quantum_um
    }
}
