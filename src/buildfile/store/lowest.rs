//! The lowest solid point of a union: exact, found strut by strut as they go by.

use crate::buildfile::model::Strut;
use crate::solid::lowest_z;

/// The lowest solid point of struts under exact union, quanta.
#[derive(Clone, Copy, Debug)]
pub(super) struct LowestOfUnion(f64);

impl Default for LowestOfUnion {
    /// Of nothing.
    fn default() -> Self {
        Self(f64::INFINITY)
    }
}

impl LowestOfUnion {
    /// Takes in one strut more.
    pub(super) fn add(&mut self, strut: &Strut) {
        // Most struts of a part are far above its bottom.
        if f64::from(strut.a[2]) - f64::from(strut.radius_a.max(strut.radius_b)) < self.0 {
            self.0 = self.0.min(lowest_z(&strut.beam()));
        }
    }

    /// Micrometres.
    pub(super) fn um(self, quantum_um: f64) -> f64 {
        self.0 * quantum_um
    }
}
