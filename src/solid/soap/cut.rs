//! Where struts are cut, so that they no longer meet their neighbours, and in which order they are taken. `node` uses it.

use glam::DVec3;

use super::NoFilm;

/// Square of the length of the sum of two unit vectors at 179°: (2 sin ½°)². Two struts that are straighter need no node.
const STRAIGHT: f64 = 3.046_096_872_175_217e-4;

/// Square of the distance between two unit vectors at [`super::Node::LEAST_ANGLE_DEG`], 10°: (2 sin 5°)².
const CLOSE: f64 = 0.030_384_493_975_583_6;

/// Distance from the node at which struts in directions `a` and `b` no longer meet, in radii: `1 / tan(θ/2)` (Eq. 3).
///
/// Of unit vectors it is `|a + b| / |a − b|`, which is exact to a few ulps at any angle.
pub(super) fn meeting(a: DVec3, b: DVec3) -> f64 {
    (a + b).length() / (a - b).length()
}

/// Distance at which the strut `of` is cut, in radii: `1 + λ` times the farthest meeting with another direction (Eq. 4 and 5).
pub(super) fn cut(directions: &[DVec3], of: usize, lambda: f64) -> f64 {
    let others = directions.iter().enumerate().filter(|(other, _)| *other != of);
    let farthest = others.map(|(_, other)| meeting(directions[of], *other)).fold(0.0, f64::max);
    (1.0 + lambda) * farthest
}

/// Fills `order` with the numbers of the directions, sorted by their coordinates, so that the order in which they were given changes no bit.
pub(super) fn sort(directions: &[DVec3], order: &mut Vec<usize>) {
    order.clear();
    order.extend(0..directions.len());
    let key = |at: &usize| directions[*at].to_array();
    order.sort_unstable_by(|a, b| {
        let pairs = key(a).into_iter().zip(key(b));
        pairs.map(|(a, b)| a.total_cmp(&b)).find(|order| order.is_ne()).unwrap_or_else(|| a.cmp(b))
    });
}

/// Refuses directions between which no film can be: two that form a straight line, and pairs that are too close.
pub(super) fn check_angles(directions: &[DVec3]) -> Result<(), NoFilm> {
    if let [a, b] = directions
        && (*a + *b).length_squared() < STRAIGHT
    {
        return Err(NoFilm::Straight);
    }
    for (second, b) in directions.iter().enumerate() {
        // A strut may not be too close even if long: see `Node::LEAST_ANGLE_DEG`.
        if let Some(first) = directions[..second].iter().position(|a| (*a - *b).length_squared() < CLOSE) {
            return Err(NoFilm::Close { struts: [first, second] });
        }
    }
    Ok(())
}
