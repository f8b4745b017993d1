//! What a linear map makes of round struts: it scales radii, and makes them oval where it stretches directions differently.

use glam::DMat3;

/// Most that a strut's surface may lie off where a map puts it, micrometres. A build file knows round struts only, so an oval
/// one gets its mean radius. `pack` knows no machine: 25 µm are about one pixel of the finest machines and half a pixel of the
/// common ones of 50 µm, less than a pixel picture shows.
pub(super) const ROUND_TOLERANCE_UM: f64 = 25.0;

/// A map that flattens by more than this share has no use, and its inverse no accuracy.
const LEAST_SHARE: f64 = 1e-6;

/// Rotations that make a symmetric 3 × 3 matrix diagonal to the last bit: Jacobi's method doubles the digits in each of its
/// sweeps of three rotations, and four are enough for `f64`; two more are for rounding.
const SWEEPS: usize = 6;

/// The factors by which a map lengthens what it maps: the least and the largest of all directions (its singular values).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stretch {
    least: f64,
    most: f64,
}

impl Stretch {
    /// All directions alike.
    pub(super) fn uniform(factor: f64) -> Self {
        Self { least: factor, most: factor }
    }

    /// Of a map; `None` where it flattens, or is no map of finite numbers.
    pub(super) fn of(map: DMat3) -> Option<Self> {
        let [x, y, z] = eigenvalues(map.transpose() * map);
        let (least, most) = (x.min(y).min(z).max(0.0).sqrt(), x.max(y).max(z).sqrt());
        (most.is_finite() && least > LEAST_SHARE * most).then_some(Self { least, most })
    }

    /// Least and largest factor.
    pub(super) fn range(self) -> [f64; 2] {
        [self.least, self.most]
    }

    /// Factor on radii: the mean of least and largest, from which no direction differs by more than half of what they differ.
    pub(super) fn mean(self) -> f64 {
        (self.least + self.most) / 2.0
    }

    /// Most that a surface of this radius with the mean factor lies off where the map puts it, in the radius's unit.
    pub(super) fn off(self, radius: f64) -> f64 {
        radius * (self.most - self.least) / 2.0
    }
}

/// Eigenvalues of a symmetric matrix, by Jacobi's method.
fn eigenvalues(symmetric: DMat3) -> [f64; 3] {
    let mut a = symmetric.to_cols_array_2d();
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            // The rotation in the plane of p and q that makes a[p][q] zero, by the smaller of its two angles.
            let ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let tangent = 1.0_f64.copysign(ratio) / (ratio.abs() + (ratio * ratio + 1.0).sqrt());
            let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
            let sine = tangent * cosine;
            let change = tangent * a[p][q];
            a[p][p] -= change;
            a[q][q] += change;
            (a[p][q], a[q][p]) = (0.0, 0.0);
            let r = 3 - p - q;
            let (rp, rq) = (cosine * a[r][p] - sine * a[r][q], sine * a[r][p] + cosine * a[r][q]);
            (a[r][p], a[p][r], a[r][q], a[q][r]) = (rp, rp, rq, rq);
        }
    }
    [a[0][0], a[1][1], a[2][2]]
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    #[test]
    fn factors_are_those_of_the_directions_stretched_least_and_most() {
        for (factors, axis) in [([1.0, 1.02, 1.03], DVec3::X), ([0.2, 5.0, 1.0], DVec3::ONE), ([7.0; 3], DVec3::Y)] {
            let [before, after] =
                [0.3, 1.9].map(|angle| DMat3::from_quat(DQuat::from_axis_angle(axis.normalize(), angle)));
            let map = after * DMat3::from_diagonal(DVec3::from(factors)) * before;
            for map in [map, map * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0))] {
                let stretch = Stretch::of(map).expect("a map");
                let least = factors.into_iter().fold(f64::INFINITY, f64::min);
                let most = factors.into_iter().fold(0.0, f64::max);
                let [found_least, found_most] = stretch.range();
                assert!((found_least - least).abs() < 1e-13 * most && (found_most - most).abs() < 1e-13 * most);
                assert_eq!(stretch.off(2.0), found_most - found_least);
                // No direction of a ball of radius 2 is farther from the mean.
                let off = factors.map(|factor| 2.0 * (factor - stretch.mean()).abs());
                assert!(off.into_iter().all(|off| off <= stretch.off(2.0) + 1e-12));
            }
        }
        // A shear has factors φ and 1/φ.
        let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
        let shear = Stretch::of(DMat3::from_cols(DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Z)).expect("a map");
        assert!((shear.most - golden).abs() < 1e-14 && (shear.least - 1.0 / golden).abs() < 1e-14);
    }

    #[test]
    fn what_flattens_or_is_no_map_has_no_factors() {
        assert_eq!(Stretch::of(DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0))), None);
        assert_eq!(Stretch::of(DMat3::from_diagonal(DVec3::new(1.0, 1.0, f64::NAN))), None);
        assert_eq!(Stretch::of(DMat3::from_diagonal(DVec3::splat(1e200))), None);
    }
}
