//! Properties of the join by elliptic arcs, and of fractions, as plain mathematics.

use layerd::solid::reference::{elliptic, fractions};
use proptest::prelude::*;

use crate::properties;

fn fields() -> impl Strategy<Value = Vec<f64>> {
    let field = prop_oneof![1 => Just(0.0), 5 => 0.0..3.0_f64];
    prop::collection::vec(field, 1..7)
}

/// tan θ₁ for angles from 0.1° to 44°.
fn least() -> impl Strategy<Value = f64> {
    (0.1..44.0_f64).prop_map(|degrees| degrees.to_radians().tan())
}

/// The form for two fields, with the angles of the paper.
fn binary(f1: f64, f2: f64, c: f64, s: f64) -> f64 {
    if f2 <= s * f1 || f1 <= c * f2 {
        return f1.max(f2);
    }
    let (kc, ks) = (1.0 / ((1.0 - c) * (1.0 - c)), 1.0 / ((1.0 - s) * (1.0 - s)));
    let (a, b) = (c * c * kc + s * s * ks - 1.0, -2.0 * (c * f1 * kc + s * f2 * ks));
    let e = f1 * f1 * kc + f2 * f2 * ks;
    2.0 * e / (-b + (b * b - 4.0 * a * e).max(0.0).sqrt())
}

proptest! {
    #![proptest_config(properties::cases(2000))]

    #[test]
    fn the_order_does_not_matter(fields in fields(), s in least(), turns in 0..7_usize) {
        let all = vec![s; fields.len()];
        let joined = elliptic(&fields, &all);
        let mut other = fields.clone();
        other.rotate_left(turns % fields.len());
        other.reverse();
        prop_assert!((elliptic(&other, &all) - joined).abs() <= 1e-12 * joined);
    }

    #[test]
    fn it_lies_between_the_greatest_field_and_the_root_of_squares(fields in fields(), s in least()) {
        let joined = elliptic(&fields, &vec![s; fields.len()]);
        let greatest = fields.iter().copied().fold(0.0, f64::max);
        let squares = fields.iter().map(|field| field * field).sum::<f64>().sqrt();
        prop_assert!(joined >= greatest * (1.0 - 1e-12) && joined <= squares * (1.0 + 1e-12));
        let second = fields.iter().copied().filter(|field| *field < greatest).fold(0.0, f64::max);
        let is_alone = fields.iter().filter(|field| **field == greatest).count() == 1;
        if is_alone && second <= s * greatest {
            prop_assert!((joined - greatest).abs() <= 1e-12 * greatest, "untouched outside the blend");
        }
    }

    #[test]
    fn it_solves_its_equation(fields in fields(), s in least()) {
        let joined = elliptic(&fields, &vec![s; fields.len()]);
        let left: f64 = fields.iter().map(|field| (field - s * joined).max(0.0).powi(2)).sum();
        prop_assert!((left - ((1.0 - s) * joined).powi(2)).abs() <= 1e-11 * joined * joined);
    }

    #[test]
    fn scaling_and_growing_fields_scale_and_raise_it(fields in fields(), s in least(), factor in 0.1..9.0_f64, more in 0.0..1.0_f64) {
        let all = vec![s; fields.len()];
        let joined = elliptic(&fields, &all);
        let scaled: Vec<_> = fields.iter().map(|field| field * factor).collect();
        prop_assert!((elliptic(&scaled, &all) - factor * joined).abs() <= 1e-11 * factor * joined);
        let mut raised = fields.clone();
        raised[0] += more;
        prop_assert!(elliptic(&raised, &all) >= joined * (1.0 - 1e-12));
    }

    #[test]
    fn two_fields_may_have_two_angles(f1 in 0.001..3.0_f64, f2 in 0.001..3.0_f64, c in least(), s in least()) {
        let joined = elliptic(&[f1, f2], &[c, s]);
        prop_assert!((joined - binary(f1, f2, c, s)).abs() <= 1e-10 * joined, "{joined} is {}", binary(f1, f2, c, s));
    }

    /// C¹: along any line of fields, the slopes on both sides of the borders of a blend agree.
    #[test]
    fn its_slope_does_not_jump(f1 in 0.1..3.0_f64, c in least(), s in least()) {
        let step = 1e-5 * f1;
        for border in [s * f1, f1 / c] {
            let at = |f2: f64| elliptic(&[f1, f2], &[c, s]);
            let below = (at(border) - at(border - step)) / step;
            let above = (at(border + step) - at(border)) / step;
            // Curvature grows as 1/(1 − s)².
            let bend = 3.0 * step / f1 / ((1.0 - s) * (1.0 - c)).powi(2);
            prop_assert!((below - above).abs() <= bend.max(1e-6), "{below} and {above} at {border}");
        }
    }

    #[test]
    fn fractions_add_up_to_one(fields in fields()) {
        let shares = fractions(&fields);
        prop_assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        prop_assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)));
    }
}

#[test]
fn equal_fields_join_as_the_formula_says() {
    for degrees in [5.0_f64, 15.0, 22.5, 40.0] {
        let s = degrees.to_radians().tan();
        for count in 2..6 {
            let root = f64::from(count).sqrt();
            let joined = elliptic(&vec![1.0; count as usize], &vec![s; count as usize]);
            assert!((joined - root / (1.0 + (root - 1.0) * s)).abs() < 1e-12, "{count} fields, {degrees}°");
        }
    }
}
