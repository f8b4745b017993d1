//! The field in plain `f64`, straight from the formulas. The tests compare the fast kernels with it.
//!
//! Liu et al. 2021, Eq. 5 and 6: `F(p) = Σ w ∫ (1 − |p−x|²/R²)² dx`, over the part of each strut within R of p. The closed form below
//! was derived from that integral; it replaces their Eq. 7, whose print could not be relied on. [`solid`](crate::solid) has an example.

use super::{Beam, weight};

/// Field of one beam at `p`; `support` is R. A ball is a point source. Any unit of length, the same for all arguments.
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

/// Field at `v` of a strut that runs from the origin along the unit vector `u`. The weight varies linearly between its ends.
///
/// Closed form of Liu et al. 2021, Eq. 6, extended to a linear weight `w + w'·x`. Let t be the axial coordinate of v's foot on the strut
/// and h the distance from it, q = R² − h² and s = √q. The part of the strut within R is `[lo, hi]`, measured from the foot. Then
/// `F R⁴ = w (G(hi) − G(lo)) + w' (H(hi) − H(lo))` with `G(x) = q²x − ⅔qx³ + x⁵/5` and `H(x) = −(q − x²)³/6`.
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
