//! The closed form against the integral it stands for, and the facts that follow from it (Liu et al. 2021, §3).

mod properties;

use layerd::solid::reference::beam_field;
use layerd::solid::{Beam, Cap, ISOVALUE};
use proptest::prelude::*;

fn strut(a: [f64; 3], b: [f64; 3], radius_a: f64, radius_b: f64) -> Beam {
    Beam { a, b, radius_a, radius_b, caps: [Cap::Sphere; 2] }
}

fn point(range: f64) -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(-range..range)
}

/// Weight of an endless strut of that radius, written out anew.
fn weight(radius: f64, support: f64) -> f64 {
    15.0 * ISOVALUE * support.powi(4) / (16.0 * (support * support - radius * radius).powf(2.5))
}

/// The defining integral by Simpson's rule on a part of the strut that holds all within reach.
fn integral(beam: &Beam, support: f64, p: [f64; 3]) -> f64 {
    const STEPS: usize = 4000;
    let weights = [weight(beam.radius_a, support), weight(beam.radius_b, support)];
    let length = (0..3).map(|k| (beam.b[k] - beam.a[k]).powi(2)).sum::<f64>().sqrt();
    let integrand = |share: f64| {
        let d2 = (0..3).map(|k| (beam.a[k] + share * (beam.b[k] - beam.a[k]) - p[k]).powi(2)).sum::<f64>();
        let inside = (1.0 - d2 / (support * support)).max(0.0);
        (weights[0] + share * (weights[1] - weights[0])) * inside * inside
    };
    let step = 1.0 / STEPS as f64;
    let sum: f64 = (0..STEPS)
        .map(|i| {
            let x = i as f64 * step;
            integrand(x) + 4.0 * integrand(x + step / 2.0) + integrand(x + step)
        })
        .sum();
    sum * step / 6.0 * length
}

proptest! {
    #![proptest_config(properties::cases(64))]

    #[test]
    fn the_closed_form_is_the_integral(
        a in point(2.0), b in point(2.0), p in point(2.0), ra in 0.05..0.9_f64, rb in 0.05..0.9_f64,
    ) {
        let beam = strut(a, b, ra, rb);
        let (closed, numeric) = (beam_field(&beam, 1.0, p), integral(&beam, 1.0, p));
        prop_assert!((closed - numeric).abs() < 1e-6 * (1.0 + numeric), "{closed} {numeric}");
    }

    #[test]
    fn a_strut_cut_in_two_gives_the_same_field(a in point(2.0), b in point(2.0), p in point(2.0), cut in 0.05..0.95_f64) {
        let middle = [0, 1, 2].map(|k| a[k] + cut * (b[k] - a[k]));
        let whole = beam_field(&strut(a, b, 0.5, 0.5), 1.0, p);
        let halves = beam_field(&strut(a, middle, 0.5, 0.5), 1.0, p) + beam_field(&strut(middle, b, 0.5, 0.5), 1.0, p);
        prop_assert!((whole - halves).abs() < 1e-9, "{whole} {halves}");
    }

    #[test]
    fn farther_than_the_support_there_is_nothing(a in point(1.0), b in point(1.0), direction in point(1.0)) {
        let norm = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
        prop_assume!(norm > 0.1);
        // Both ends lie within √3 of the origin.
        let p = direction.map(|x| x / norm * (3.0_f64.sqrt() + 1.001));
        prop_assert_eq!(beam_field(&strut(a, b, 0.5, 0.4), 1.0, p), 0.0);
    }
}

#[test]
fn a_long_strut_and_a_lone_ball_have_their_radius() {
    for radius in [0.1, 0.5, 2.0 / 3.0, 0.9] {
        let long = strut([-5.0, 0.0, 0.0], [5.0, 0.0, 0.0], radius, radius);
        assert!((beam_field(&long, 1.0, [0.3, 0.0, radius]) - ISOVALUE).abs() < 1e-9);
        let ball = strut([1.0; 3], [1.0; 3], radius, radius);
        assert!((beam_field(&ball, 1.0, [1.0 + radius, 1.0, 1.0]) - ISOVALUE).abs() < 1e-9);
    }
}
