//! The field in plain `f64`, as the formulas read: every faster way is measured against it.
//!
//! Liu et al. 2021, §3: `F(p) = Σ w ∫ (1 − |p−x|²/R²)² dx` over the part of each strut within R of p. The closed form was
//! derived anew from that integral.

use super::{Beam, weight};

/// Field of one beam at `p`; `support` is R. A ball is a point source. Any unit of length, the same for all.
pub fn beam_field(beam: &Beam, support: f64, p: [f64; 3]) -> f64 {
    let share = |radius: f64| radius / support;
    let v = [0, 1, 2].map(|axis| p[axis] - beam.a[axis]);
    let (u, length) = super::direction(beam.a, beam.b);
    if length == 0.0 {
        let rest = (1.0 - dot(v, v) / (support * support)).max(0.0);
        return weight::ball(share(beam.radius_a)) * rest * rest;
    }
    let [weight_a, weight_b] = [beam.radius_a, beam.radius_b].map(|radius| weight::strut(share(radius)) / support);
    strut_field(v, u, length, [weight_a, weight_b], support)
}

/// Field of a strut from the origin along the unit vector `u` at `v`; the weight runs linearly between its ends.
///
/// With t the axial coordinate of v's foot, q = R² − h² and s = √q, the part within R is `[lo, hi]` measured from the foot,
/// and `F R⁴ = w (G(hi) − G(lo)) + w' (H(hi) − H(lo))`, `G(x) = q²x − ⅔qx³ + x⁵/5`, `H(x) = −(q − x²)³/6`.
fn strut_field(v: [f64; 3], u: [f64; 3], length: f64, weights: [f64; 2], support: f64) -> f64 {
    let t = dot(v, u);
    let foot = [0, 1, 2].map(|axis| v[axis] - t * u[axis]);
    let q = support * support - dot(foot, foot);
    if q <= 0.0 {
        return 0.0;
    }
    let s = q.sqrt();
    let (lo, hi) = ((-t).clamp(-s, s), (length - t).clamp(-s, s));
    let slope = (weights[1] - weights[0]) / length;
    let g = |x: f64| q * q * x - 2.0 / 3.0 * q * x.powi(3) + x.powi(5) / 5.0;
    let h = |x: f64| -(q - x * x).powi(3) / 6.0;
    ((weights[0] + slope * t) * (g(hi) - g(lo)) + slope * (h(hi) - h(lo))) / support.powi(4)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
