//! From the radius a strut shall print at to its weight in the field (Liu et al. 2021, §3, re-derived).

use super::ISOVALUE;

/// Radii at or above this share of the support are refused: the weight grows without bound towards 1.
pub const LARGEST_RADIUS_SHARE: f64 = 0.95;

/// Weight times support of a strut of radius `share · R`, so that an endless strut prints at that radius:
/// `15 C / (16 (1 − share²)^{5/2})`. `share` is in `0.0..LARGEST_RADIUS_SHARE`.
pub(super) fn strut(share: f64) -> f64 {
    let rest = 1.0 - share * share;
    15.0 * ISOVALUE / (16.0 * rest * rest * rest.sqrt())
}

/// Weight of a ball, a point source `w (1 − d²/R²)²`, so that alone it prints at radius `share · R`.
pub(super) fn ball(share: f64) -> f64 {
    let rest = 1.0 - share * share;
    ISOVALUE / (rest * rest)
}
