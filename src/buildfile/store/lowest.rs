//! The lowest solid point of unions and surfaces, exact, and of reliefs as `relief` finds it. `writer` and `reader` pass all struts and triangles through it.

use crate::buildfile::model::{QUANTUM_FRACTIONS, Strut, Triangle};
use crate::solid::lowest_z;

/// The lowest solid point of the struts and triangles added so far, quanta.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lowest(f64);

impl Default for Lowest {
    /// Of nothing.
    fn default() -> Self {
        Self(f64::INFINITY)
    }
}

impl Lowest {
    /// Adds a strut.
    pub(super) fn add(&mut self, strut: &Strut) {
        // Most struts of a part are far above its bottom: a cheap test first.
        if f64::from(strut.a[2]) - f64::from(strut.radius_a.max(strut.radius_b)) < self.0 {
            self.0 = self.0.min(lowest_z(&strut.beam()));
        }
    }

    /// Adds a triangle.
    pub(super) fn add_triangle(&mut self, triangle: &Triangle) {
        self.add_z(triangle.corners[0][2] as f64 / QUANTUM_FRACTIONS as f64);
    }

    /// Adds a point at `z` quanta.
    pub(super) fn add_z(&mut self, z: f64) {
        self.0 = self.0.min(z);
    }

    /// The point, micrometres.
    pub(super) fn um(self, quantum_um: f64) -> f64 {
        self.0 * quantum_um
    }
}
