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

/// Field at `p` of the part of a beam that is of one material: its share varies linearly from `shares[0]` at `a` to `shares[1]` at `b`.
/// Otherwise as [`beam_field`], which is the sum of all materials' parts.
pub fn shared_beam_field(beam: &Beam, shares: [f64; 2], support: f64, p: [f64; 3]) -> f64 {
    let (u, length) = super::direction(beam.a, beam.b);
    if length == 0.0 {
        return shares[0] * beam_field(beam, support, p);
    }
    let v = [0, 1, 2].map(|axis| p[axis] - beam.a[axis]);
    let [weight_a, weight_b] = [beam.radius_a, beam.radius_b].map(|radius| weight::strut(radius / support) / support);
    let ends = [weight_a * shares[0], weight_b * shares[1]];
    // The product of two linear functions, less the linear function between its ends, is this times t (t − length).
    let bow = (weight_b - weight_a) * (shares[1] - shares[0]) / (length * length);
    strut_field(v, u, length, ends, support) + bow * bow_field(v, u, length, support)
}

/// `∫ t (t − L) (1 − |p−x|²/R²)² dx` along a strut, with t measured from its start. With t = x − lo and t − L = x − hi, and `lo` and `hi` the ends
/// measured from the foot of p, it is `M₂ − (lo + hi) M₁ + lo hi M₀`, where `M₂ = q²x³/3 − ⅖ q x⁵ + x⁷/7`.
fn bow_field(v: [f64; 3], u: [f64; 3], length: f64, support: f64) -> f64 {
    let t = dot(v, u);
    let foot = [0, 1, 2].map(|axis| v[axis] - t * u[axis]);
    let q = support * support - dot(foot, foot);
    if q <= 0.0 {
        return 0.0;
    }
    let s = q.sqrt();
    let (lo, hi) = (-t, length - t);
    let antiderivative = |x: f64| {
        let zeroth = q * q * x - 2.0 / 3.0 * q * x.powi(3) + x.powi(5) / 5.0;
        let first = -(q - x * x).powi(3) / 6.0;
        let second = q * q * x.powi(3) / 3.0 - 2.0 / 5.0 * q * x.powi(5) + x.powi(7) / 7.0;
        second - (lo + hi) * first + lo * hi * zeroth
    };
    (antiderivative(hi.clamp(-s, s)) - antiderivative(lo.clamp(-s, s))) / support.powi(4)
}

/// The field of a solid whose materials have these fields, joined by elliptic arcs: `max(f₁, f₂)` where one of them is below its `least` share
/// of the other, and in between the root of `((f₁ − c G)/(1 − c))² + ((f₂ − s G)/(1 − s))² = G²` with c and s = `least` (heterogeneous lattices, Eq. 3.5 and
/// 3.7). It is C¹, homogeneous, and between the greatest field and the root of the sum of squares.
///
/// For more than two materials, `least` holds one value s for all, and G is the root of `Σ max(fᵢ − s G, 0)² = (1 − s)² G²`, which is the same for
/// two and does not depend on the order of the fields. Fields are at least 0; `least` is above 0 and below 1, and has a value for each field.
pub fn elliptic(fields: &[f64], least: &[f64]) -> f64 {
    let mut terms: Vec<[f64; 2]> = fields.iter().zip(least).map(|(field, least)| [*field, *least]).collect();
    // In the order in which they leave their least share of a falling G.
    terms.sort_by(|one, other| (other[0] / other[1]).total_cmp(&(one[0] / one[1])));
    let (mut a, mut b, mut e, mut joined) = (-1.0, 0.0, 0.0, 0.0);
    for [field, least] in terms {
        if field <= least * joined {
            break;
        }
        let scale = 1.0 / ((1.0 - least) * (1.0 - least));
        a += least * least * scale;
        b -= 2.0 * least * field * scale;
        e += field * field * scale;
        joined = 2.0 * e / ((b * b - 4.0 * a * e).max(0.0).sqrt() - b);
    }
    joined
}

/// The shares of materials with these fields at a point: Vᵢ = Fᵢ / ΣFⱼ (heterogeneous lattices, Eq. 4.1, with fields in place of distances).
/// Where no field is above 0, the first material has all of it.
pub fn fractions(fields: &[f64]) -> Vec<f64> {
    let sum: f64 = fields.iter().sum();
    let share = |(number, field): (usize, &f64)| if sum > 0.0 { field / sum } else { f64::from(u8::from(number == 0)) };
    fields.iter().enumerate().map(share).collect()
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
