//! From the radius at which a strut is to print to its weight in the field. The weight is `r` of Liu et al. 2021, Eq. 6, which is not a
//! radius; the relations below were derived from the field on the surface of an endless strut and of a single ball.
//! `Convolution::ends` uses them.

use super::ISOVALUE;

/// Radii of this share of the support or more are refused, because the weight goes to infinity where the share goes to 1.
pub(crate) const MAX_RADIUS_SHARE: f64 = 0.95;

/// Weight times support of a strut with radius `share · R`, so that an endless strut prints at that radius:
/// `w R = 15 C / (16 (1 − share²)^{5/2})`, from `F = 16 w (R² − h²)^{5/2} / (15 R⁴)` at distance h. `share` is in
/// `0.0..MAX_RADIUS_SHARE`.
pub(super) fn strut(share: f64) -> f64 {
    let rest = 1.0 - share * share;
    15.0 * ISOVALUE / (16.0 * rest * rest * rest.sqrt())
}

/// Weight of a ball, a point source `w (1 − d²/R²)²` (Liu et al. 2021, Eq. 5), so that by itself it prints at radius `share · R`.
pub(super) fn ball(share: f64) -> f64 {
    let rest = 1.0 - share * share;
    ISOVALUE / (rest * rest)
}
