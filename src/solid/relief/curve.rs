//! Curved triangles: cubic patches through the corners, perpendicular to the normals there (PN triangles; Vlachos, Peters, Boyd and
//! Mitchell 2001, §3.1 and §3.2). `patch` evaluates them.

use glam::DVec3;

use super::patch::EDGES;

/// The control points of a patch. Its edges depend on the two corners of each alone, so neighbours with equal normals meet exactly.
#[derive(Clone, Copy, Debug)]
pub(super) struct Curve {
    corners: [DVec3; 3],
    /// For each of [`EDGES`], the point near its first and the one near its second corner.
    edges: [[DVec3; 2]; 3],
    middle: DVec3,
    bend: f64,
    /// Of each edge alone.
    edge_bends: [f64; 3],
}

impl Curve {
    /// The patch through `corners` with these unit normals.
    pub(super) fn new(corners: [DVec3; 3], normals: [DVec3; 3]) -> Self {
        // A third of the way along the edge, moved into the plane through `from` perpendicular to its normal.
        let near = |from: usize, to: usize| {
            let along = (corners[to] - corners[from]).dot(normals[from]);
            (corners[from] * 2.0 + corners[to] - normals[from] * along) / 3.0
        };
        let edges = EDGES.map(|[from, to]| [near(from, to), near(to, from)]);
        let of_edges = edges.iter().flatten().sum::<DVec3>() / 6.0;
        let of_corners = corners.iter().sum::<DVec3>() / 3.0;
        let middle = of_edges + (of_edges - of_corners) / 2.0;
        let edge_bends = [0, 1, 2].map(|edge| {
            let ([from, to], [near_from, near_to]) = (EDGES[edge].map(|corner| corners[corner]), edges[edge]);
            bend_of([[from, near_from, near_to], [near_from, near_to, to]]) * 0.75
        });
        Self { corners, edges, middle, bend: bend(corners, edges, middle), edge_bends }
    }

    /// The point of these weights of the corners. Where a weight is 0, it depends on the other two corners alone, bit for bit.
    pub(super) fn point(&self, weights: [f64; 3]) -> DVec3 {
        let cubes = |corner: usize| self.corners[corner] * weights[corner].powi(3);
        let edge = |edge: usize| {
            let [from, to] = EDGES[edge];
            let points = self.edges[edge];
            (points[0] * weights[from] + points[1] * weights[to]) * (3.0 * weights[from] * weights[to])
        };
        let inner = self.middle * (6.0 * weights[0] * weights[1] * weights[2]);
        (cubes(0) + cubes(1) + cubes(2)) + (edge(0) + edge(1) + edge(2)) + inner
    }

    /// Bound of the distance between the patch and the flat triangle with the same corners. A part of the patch whose weights differ by at
    /// most `s` is within `s²` of that of its own flat triangle.
    pub(super) fn bend(&self) -> f64 {
        self.bend
    }

    /// As [`Curve::bend`], of a line between two points. On an edge of the patch, it depends on that edge alone.
    pub(super) fn bend_between(&self, a: [f64; 3], b: [f64; 3]) -> f64 {
        let edge = EDGES.iter().position(|[from, to]| a[3 - from - to] == 0.0 && b[3 - from - to] == 0.0);
        edge.map_or(self.bend, |edge| self.edge_bends[edge])
    }
}

/// Let M be the greatest second difference of the control points along an edge of the patch. Second derivatives along an edge are at most
/// 6 M, along any line whose weights change by at most 1 at most 9 M, and along two such lines at most 13.5 M. The remainder of a linear
/// interpolation, `½ Σ λ_i (1 − λ_i)²` times that, is then at most 3 M.
fn bend(corners: [DVec3; 3], edges: [[DVec3; 2]; 3], middle: DVec3) -> f64 {
    let [a, b, c] = corners;
    let [[ab, ba], [bc, cb], [ac, ca]] = edges;
    let rows = [
        [a, ab, ba],
        [ab, ba, b],
        [ac, middle, bc],
        [a, ac, ca],
        [ac, ca, c],
        [ab, middle, cb],
        [b, bc, cb],
        [bc, cb, c],
        [ba, middle, ca],
    ];
    3.0 * bend_of(rows)
}

/// The greatest second difference. That of a cubic line times ¾ is how far it may be from a linear interpolation.
fn bend_of<const N: usize>(rows: [[DVec3; 3]; N]) -> f64 {
    rows.map(|[before, here, after]| (before - here * 2.0 + after).length()).into_iter().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patch_of_a_sphere_is_nearer_to_it_than_the_flat_triangle() {
        // Corners 20° apart.
        let corners = [[3.0, 2.0, 2.0], [2.0, 3.0, 2.0], [2.0, 2.0, 3.0]].map(|corner| DVec3::from(corner).normalize());
        let curve = Curve::new(corners, corners);
        let weights = |number: u32| {
            let [a, b] = [f64::from(number % 33) / 32.0, f64::from(number / 33) / 32.0];
            [a, b * (1.0 - a), (1.0 - b) * (1.0 - a)]
        };
        let off = |point: DVec3| (point.length() - 1.0).abs();
        let largest = (0..33 * 33).map(|number| off(curve.point(weights(number)))).fold(0.0, f64::max);
        let flat = off(corners.iter().sum::<DVec3>() / 3.0);
        assert!(largest * 9.0 < flat, "{largest}; the flat one is off by {flat}");
    }

    #[test]
    fn parts_stay_within_their_bend() {
        let corners = [DVec3::new(0.1, 0.0, 0.3), DVec3::new(4.0, 0.5, 0.0), DVec3::new(1.0, 3.0, 0.7)];
        let normals = [DVec3::new(-0.5, -0.3, 1.0), DVec3::new(0.8, 0.1, 1.0), DVec3::new(0.0, 0.9, 0.6)];
        let curve = Curve::new(corners, normals.map(DVec3::normalize));
        let mut closest = f64::MAX;
        for side in [1.0, 0.5, 0.25] {
            for first in [[1.0 - side, 0.0], [0.0, 1.0 - side], [0.0, 0.0], [(1.0 - side) / 2.0; 2]] {
                let part = [[side, 0.0], [0.0, side], [0.0, 0.0]].map(|[a, b]| {
                    let [a, b] = [first[0] + a, first[1] + b];
                    [a, b, 1.0 - a - b]
                });
                let ends = part.map(|weights| curve.point(weights));
                for number in 0..81 {
                    let [a, b] = [f64::from(number % 9) / 8.0, f64::from(number / 9) / 8.0];
                    let inner = [a, b * (1.0 - a), (1.0 - b) * (1.0 - a)];
                    let mix = |values: [f64; 3]| values[0] * inner[0] + values[1] * inner[1] + values[2] * inner[2];
                    let weights = [0, 1, 2].map(|corner| mix(part.map(|weights| weights[corner])));
                    let flat = ends[0] * inner[0] + ends[1] * inner[1] + ends[2] * inner[2];
                    let off = (curve.point(weights) - flat).length();
                    assert!(off <= curve.bend() * side * side, "{off} at {weights:?}");
                    closest = closest.min(curve.bend() * side * side / off);
                }
            }
        }
        assert!(closest < 30.0, "the bound is {closest} times too wide");
    }

    #[test]
    fn an_edge_depends_on_its_own_corners() {
        let [a, b] = [DVec3::new(0.1, 0.7, -3.3), DVec3::new(5.7, 1.3, 0.9)];
        let [na, nb] = [DVec3::new(0.1, 0.3, 0.8).normalize(), DVec3::new(-0.4, 0.3, 0.7).normalize()];
        let (c, d) = (DVec3::new(2.0, 9.0, 1.0), DVec3::new(3.0, -7.0, 1.5));
        let one = Curve::new([a, b, c], [na, nb, DVec3::Z]);
        let other = Curve::new([a, d, b], [na, DVec3::X, nb]);
        for step in 0..=64 {
            let share = f64::from(step) / 64.0;
            assert_eq!(one.point([1.0 - share, share, 0.0]), other.point([1.0 - share, 0.0, share]));
        }
    }
}
