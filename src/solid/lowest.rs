//! How far down a beam or ball reaches under exact union.

use super::{Beam, Cap};

/// Lowest z of a beam or ball, exact but for rounding, in the unit of its coordinates. The body is the convex hull of the discs
/// at its ends; each cap may reach lower than its disc.
pub fn lowest_z(beam: &Beam) -> f64 {
    let [dx, dy, dz] = [0, 1, 2].map(|axis| beam.b[axis] - beam.a[axis]);
    let flat = dx * dx + dy * dy;
    let length = (flat + dz * dz).sqrt();
    if length == 0.0 {
        return beam.a[2] - beam.radius_a;
    }
    // A disc square to the beam reaches down by this share of its radius.
    let lean = flat.sqrt() / length;
    let end = |z: f64, radius: f64, cap: Cap, looks_down: bool| match cap {
        Cap::Sphere => z - radius,
        Cap::Hemisphere if looks_down => z - radius,
        Cap::Hemisphere | Cap::Butt => z - radius * lean,
    };
    let at_a = end(beam.a[2], beam.radius_a, beam.caps[0], dz >= 0.0);
    at_a.min(end(beam.b[2], beam.radius_b, beam.caps[1], dz <= 0.0))
}
