//! The lowest point of a beam or ball under exact union. `buildfile/store/lowest.rs` finds the bottom of a
//! part with it.

use super::{Beam, Cap};

/// Lowest z of a beam or ball, exact except for rounding, in the unit of its coordinates. A beam is the convex hull of the discs at its
/// ends, and caps that may reach lower than the discs.
pub(crate) fn lowest_z(beam: &Beam) -> f64 {
    let [dx, dy, dz] = [0, 1, 2].map(|axis| beam.b[axis] - beam.a[axis]);
    let flat = dx * dx + dy * dy;
    let length = (flat + dz * dz).sqrt();
    if length == 0.0 {
        return beam.a[2] - beam.radius_a;
    }
    // A disc perpendicular to the beam reaches this share of its radius below its centre: the sine of the angle to the vertical.
    let lean = flat.sqrt() / length;
    let end = |z: f64, radius: f64, cap: Cap, looks_down: bool| match cap {
        Cap::Sphere => z - radius,
        Cap::Hemisphere if looks_down => z - radius,
        Cap::Hemisphere | Cap::Butt => z - radius * lean,
    };
    let at_a = end(beam.a[2], beam.radius_a, beam.caps[0], dz >= 0.0);
    at_a.min(end(beam.b[2], beam.radius_b, beam.caps[1], dz <= 0.0))
}
