//! What a linear map does to round struts: it scales radii, and makes struts oval if it stretches directions differently. `rules` checks
//! every radius with it.

use glam::DMat3;

/// Largest allowed distance of the surface of a strut from where a map would put it, micrometres. A build file holds only round struts, so
/// an oval one gets its mean radius. `pack` does not know the machine: 25 µm is about one pixel of the finest machines, and half a pixel
/// of common ones.
pub(super) const ROUND_TOLERANCE_UM: f64 = 25.0;

/// Smallest ratio of the factors of a map. A map that flattens more has no use, and its inverse no accuracy.
const MIN_SHARE: f64 = 1e-6;

/// Sweeps of three rotations that make a symmetric 3 × 3 matrix diagonal to the last bit. Jacobi's method converges quadratically: four
/// sweeps are enough for `f64`, and two more allow for rounding errors.
const SWEEPS: usize = 6;

/// The smallest and the largest factor by which a map stretches any direction: the smallest and the largest of its singular values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stretch {
    smallest: f64,
    largest: f64,
}

impl Stretch {
    /// The same factor in all directions.
    pub(super) fn uniform(factor: f64) -> Self {
        Self { smallest: factor, largest: factor }
    }

    /// The factors of a map; `None` if it flattens or is not finite.
    pub(super) fn of(map: DMat3) -> Option<Self> {
        let [x, y, z] = eigenvalues(map.transpose() * map);
        let (smallest, largest) = (x.min(y).min(z).max(0.0).sqrt(), x.max(y).max(z).sqrt());
        (largest.is_finite() && smallest > MIN_SHARE * largest).then_some(Self { smallest, largest })
    }

    /// Smallest and largest factor.
    pub(super) fn range(self) -> [f64; 2] {
        [self.smallest, self.largest]
    }

    /// Factor on radii: the mean of the smallest and the largest, which minimises the largest error.
    pub(super) fn mean(self) -> f64 {
        (self.smallest + self.largest) / 2.0
    }

    /// Largest distance of a surface of this radius, scaled by the mean factor, from where the map would put it; in the unit of the radius.
    pub(super) fn off(self, radius: f64) -> f64 {
        radius * (self.largest - self.smallest) / 2.0
    }
}

/// Eigenvalues of a symmetric matrix by Jacobi's method (Golub & Van Loan 2013, Matrix Computations, §8.5, algorithm 8.5.1).
fn eigenvalues(symmetric: DMat3) -> [f64; 3] {
    let mut a = symmetric.to_cols_array_2d();
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            // The rotation in the plane of p and q that makes a[p][q] zero. Of its two angles, the smaller.
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
                let smallest = factors.into_iter().fold(f64::INFINITY, f64::min);
                let largest = factors.into_iter().fold(0.0, f64::max);
                let [found_smallest, found_largest] = stretch.range();
                assert!(
                    (found_smallest - smallest).abs() < 1e-13 * largest
                        && (found_largest - largest).abs() < 1e-13 * largest
                );
                assert_eq!(stretch.off(2.0), found_largest - found_smallest);
                // No direction of a ball of radius 2 is farther from the mean.
                let off = factors.map(|factor| 2.0 * (factor - stretch.mean()).abs());
                assert!(off.into_iter().all(|off| off <= stretch.off(2.0) + 1e-12));
            }
        }
        // A shear has factors φ and 1/φ.
        let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
        let shear = Stretch::of(DMat3::from_cols(DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Z)).expect("a map");
        assert!((shear.largest - golden).abs() < 1e-14 && (shear.smallest - 1.0 / golden).abs() < 1e-14);
    }

    #[test]
    fn what_flattens_or_is_no_map_has_no_factors() {
        assert_eq!(Stretch::of(DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0))), None);
        assert_eq!(Stretch::of(DMat3::from_diagonal(DVec3::new(1.0, 1.0, f64::NAN))), None);
        assert_eq!(Stretch::of(DMat3::from_diagonal(DVec3::splat(1e200))), None);
    }
}
