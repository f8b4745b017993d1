//! Offsets of convex rings, which most islands of a lattice are. `offset` uses them: they take a tenth of the time of the library's way.
//!
//! Only additions, products, quotients and roots are used, so the result is the same on every machine.

use super::border::place;
use super::offset::{Contour, Point, doubled_triangle_nm2};
use super::path::ring_edges;

/// Longer rings go the general way: the time for a convex ring grows with the square of its length.
const MAX_POINTS: usize = 200;

/// Whether a ring turns left at each point, and is short enough.
pub(super) fn is_convex(ring: &[Point]) -> bool {
    let count = ring.len();
    (3..=MAX_POINTS).contains(&count)
        && (0..count).all(|number| {
            let [a, b, c] = [0, 1, 2].map(|step| ring[(number + step) % count]);
            doubled_triangle_nm2(a, b, c) >= 0
        })
}

/// The part of a convex ring farther than a distance from its border; empty if there is none.
pub(super) fn inset(ring: &[Point], distance_nm: f64) -> Contour {
    let origin = ring[0];
    let mut left: Vec<[f64; 2]> = ring.iter().map(|point| place(origin, *point)).collect();
    let mut cut = Vec::with_capacity(left.len() + 1);
    for (normal, a) in edges(ring) {
        // Depth of a point behind the edge moved inwards.
        let depth = |point: &[f64; 2]| -(normal[0] * (point[0] - a[0]) + normal[1] * (point[1] - a[1])) - distance_nm;
        cut.clear();
        for (number, point) in left.iter().enumerate() {
            let next = left[(number + 1) % left.len()];
            let (here, there) = (depth(point), depth(&next));
            if here >= 0.0 {
                cut.push(*point);
            }
            if (here >= 0.0) != (there >= 0.0) {
                let share = here / (here - there);
                cut.push([0, 1].map(|axis| point[axis] + (next[axis] - point[axis]) * share));
            }
        }
        std::mem::swap(&mut left, &mut cut);
    }
    rounded(origin, &left)
}

/// The points within a distance of a convex ring. Arcs leave their circles by at most `error_nm`.
pub(super) fn outset(ring: &[Point], distance_nm: f64, error_nm: f64) -> Contour {
    let origin = ring[0];
    let least = least_cosine(distance_nm, error_nm);
    let mut grown = Vec::with_capacity(3 * ring.len());
    let edges: Vec<_> = edges(ring).collect();
    let mut before = edges.last().map_or([0.0; 2], |edge| edge.0);
    for (normal, a) in edges {
        let at = |normal: [f64; 2]| [0, 1].map(|axis| a[axis] + normal[axis] * distance_nm);
        grown.push(at(before));
        arc(before, normal, least, 1.0, &mut |normal| grown.push(at(normal)));
        grown.push(at(normal));
        before = normal;
    }
    rounded(origin, &grown)
}

/// Cosine of the largest angle between two points of an arc that leaves its circle by at most `error_nm`.
pub(super) fn least_cosine(radius_nm: f64, error_nm: f64) -> f64 {
    let half = (1.0 - error_nm / radius_nm).max(std::f64::consts::FRAC_1_SQRT_2);
    2.0 * half * half - 1.0
}

/// Unit vectors between two, halving the angle until its cosine is at least `least`. Angles are at most a straight one, to the left of
/// the first vector if `side` is 1, to the right if it is -1.
pub(super) fn arc(from: [f64; 2], to: [f64; 2], least: f64, side: f64, push: &mut impl FnMut([f64; 2])) {
    if from[0] * to[0] + from[1] * to[1] >= least {
        return;
    }
    let sum = [from[0] + to[0], from[1] + to[1]];
    let length = (sum[0] * sum[0] + sum[1] * sum[1]).sqrt();
    // Opposite ones: the middle is to the side.
    let middle = if length > 1e-6 { sum.map(|part| part / length) } else { [-from[1] * side, from[0] * side] };
    arc(from, middle, least, side, push);
    push(middle);
    arc(middle, to, least, side, push);
}

/// Each edge that is longer than nothing: its unit normal outwards, and the point it begins at, from the first point of the ring.
fn edges(ring: &[Point]) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + '_ {
    let origin = ring[0];
    ring_edges(ring).filter_map(move |[a, b]| {
        let [x, y] = place(a, b);
        let length = (x * x + y * y).sqrt();
        (length > 0.0).then(|| ([y / length, -x / length], place(origin, a)))
    })
}

/// In whole nanometres, without points that follow each other; empty if less than a triangle is left.
pub(super) fn rounded(origin: Point, ring: &[[f64; 2]]) -> Contour {
    // Adding a half and cutting off rounds faster than the library.
    let whole = |nm: f64| (nm + 0.5_f64.copysign(nm)) as i32;
    let point = |point: &[f64; 2]| Point::new(origin.x + whole(point[0]), origin.y + whole(point[1]));
    let mut points: Contour = ring.iter().map(point).collect();
    points.dedup();
    if points.first() == points.last() {
        points.pop();
    }
    if points.len() < 3 {
        points.clear();
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> Contour {
        vec![Point::new(0, 0), Point::new(3_000_000, 0), Point::new(0, 4_000_000)]
    }

    #[test]
    fn a_triangle_shrinks_to_the_middle_of_its_inner_circle() {
        // Sides of 3, 4 and 5 mm: the inner circle has a radius of 1 mm.
        assert_eq!(inset(&triangle(), 500_000.0).len(), 3);
        let small = inset(&triangle(), 999_000.0);
        assert!(small.iter().all(|point| (point.x - 1_000_000).abs() < 4000 && (point.y - 1_000_000).abs() < 4000));
        assert_eq!(inset(&triangle(), 1_001_000.0), []);
    }

    #[test]
    fn what_grows_is_round_at_the_corners() {
        let grown = outset(&triangle(), 500_000.0, 500.0);
        assert!(is_convex(&grown));
        let doubled_mm2: i64 =
            (1..grown.len() - 1).map(|at| doubled_triangle_nm2(grown[0], grown[at], grown[at + 1])).sum();
        let exact_mm2 = 6.0 + 12.0 * 0.5 + std::f64::consts::PI * 0.25;
        assert!((doubled_mm2 as f64 / 2e12 - exact_mm2).abs() < 0.003, "{doubled_mm2}");
        let notched = [[0, 0], [10, 0], [5, 1], [0, 10]].map(|[x, y]| Point::new(x, y));
        assert!(!is_convex(&notched));
    }
}
