//! Point-normal Loop subdivision (Luo & Zou 2025, Eq. 6 to 11; Yang 2023, Loop 1987): a mesh with four times the triangles, whose vertices
//! take their place from the normals too. Vertices and normals of a cylinder or a sphere give points of it. `node` calls it;
//! `tests/nodes/limit.rs` shows that it converges.

use glam::DVec3;

use super::surface::{Edge, Surface, Triangle};
use super::{across, unit_or};

/// Neighbours of a vertex in a regular mesh.
const REGULAR: u32 = 6;

/// Loop's weights of an edge's new vertex: for each end, and for each opposite corner (Eq. 9).
const END: f64 = 3.0 / 8.0;
const OPPOSITE: f64 = 1.0 / 8.0;

/// Least cosine, plus 1, of the angle between an old and a new normal. Where a mesh is folded, its formula would divide by about 0.
/// Normals less than 100° apart are not touched.
const LEAST_AGREEMENT: f64 = 0.8;

/// Refines surfaces; its buffers serve again.
#[derive(Debug, Default)]
pub(super) struct Subdivision {
    /// For each vertex, the sum over its neighbours: of points, then of heights.
    sums: Vec<DVec3>,
    normal_sums: Vec<DVec3>,
    heights: Vec<f64>,
    /// Weight of each neighbour by the number of neighbours.
    weights: Vec<f64>,
}

impl Subdivision {
    /// Fills `fine` with `coarse` refined once. `axes` and `cuts` are those of the circles. Without `joined`, `fine` cannot be refined.
    pub(super) fn refine(&mut self, coarse: &Surface, axes: &[DVec3], cuts: &[f64], joined: bool, fine: &mut Surface) {
        fine.clear();
        self.move_vertices(coarse, fine);
        add_edge_vertices(coarse, fine);
        refine_rims(coarse, axes, cuts, fine);
        let vertices = coarse.points.len() as u32;
        for (number, triangle) in (0..).zip(&coarse.triangles) {
            fine.triangles.extend(divided(number, triangle, vertices, &coarse.edges));
        }
        if joined {
            add_edges(coarse, fine);
            fine.join();
            fine.valences.extend(&coarse.valences);
            fine.valences.extend(coarse.edges.iter().map(|edge| if edge.is_rim() { 0 } else { REGULAR }));
        }
    }

    /// The new places of old vertices (Eq. 7, 8 and 10). The sums run over edges, so that no lists of neighbours are needed.
    fn move_vertices(&mut self, coarse: &Surface, fine: &mut Surface) {
        let (points, normals) = (&coarse.points, &coarse.normals);
        self.gather(coarse);
        for vertex in 0..points.len() {
            let valence = coarse.valences[vertex];
            let weight = self.weight(valence);
            let own = 1.0 - f64::from(valence) * weight;
            fine.points.push(points[vertex] * own + self.sums[vertex] * weight);
            fine.normals.push(unit_or(normals[vertex] * own + self.normal_sums[vertex] * weight, normals[vertex]));
        }
        self.heights.clear();
        self.heights.resize(points.len(), 0.0);
        for Edge { ends: [a, b], .. } in &coarse.edges {
            let [a, b] = [*a as usize, *b as usize];
            self.heights[a] += height(fine.points[a], fine.normals[a], points[b], normals[b]);
            self.heights[b] += height(fine.points[b], fine.normals[b], points[a], normals[a]);
        }
        for vertex in 0..points.len() {
            let valence = coarse.valences[vertex];
            // On a circle points and normals stay.
            if valence == 0 {
                (fine.points[vertex], fine.normals[vertex]) = (points[vertex], normals[vertex]);
                continue;
            }
            let weight = self.weight(valence);
            let (middle, normal) = (fine.points[vertex], fine.normals[vertex]);
            let own = (1.0 - f64::from(valence) * weight) * height(middle, normal, points[vertex], normals[vertex]);
            fine.points[vertex] = middle + normal * (own + weight * self.heights[vertex]);
        }
    }

    /// Sums points and normals of the neighbours of every vertex.
    fn gather(&mut self, coarse: &Surface) {
        for sums in [&mut self.sums, &mut self.normal_sums] {
            sums.clear();
            sums.resize(coarse.points.len(), DVec3::ZERO);
        }
        for Edge { ends: [a, b], .. } in &coarse.edges {
            let [a, b] = [*a as usize, *b as usize];
            self.sums[a] += coarse.points[b];
            self.sums[b] += coarse.points[a];
            self.normal_sums[a] += coarse.normals[b];
            self.normal_sums[b] += coarse.normals[a];
        }
    }

    /// Loop's weight of each of so many neighbours.
    fn weight(&mut self, valence: u32) -> f64 {
        while self.weights.len() <= valence as usize {
            self.weights.push(loop_weight(self.weights.len() as u32));
        }
        self.weights[valence as usize]
    }
}

/// β of Eq. 8; 0 for vertices of a circle, which have no valence.
fn loop_weight(valence: u32) -> f64 {
    if valence == 0 {
        return 0.0;
    }
    let root = 0.375 + cosine_of_turn(valence) / 4.0;
    (0.625 - root * root) / f64::from(valence)
}

/// Cosine of `2π / parts`. The library's cosine differs between machines in its last bit, and this does not: a series for an eighth of
/// the angle, and the angle doubled three times.
fn cosine_of_turn(parts: u32) -> f64 {
    let square = (std::f64::consts::FRAC_PI_4 / f64::from(parts)).powi(2);
    // 1 − cos x, whose terms shrink below the last bit within eight for x up to π/4. It stays exact where the cosine is near 1.
    let mut versine = 0.0;
    for term in (1..=8).rev() {
        let factor = f64::from((2 * term - 1) * (2 * term));
        versine = square / factor * (1.0 - versine);
    }
    for _ in 0..3 {
        // 1 − cos 2x = 2 (1 − cos x)(1 + cos x)
        versine = 2.0 * versine * (2.0 - versine);
    }
    1.0 - versine
}

/// How far a neighbour's tangent plane lets the new vertex rise above `middle` along its `normal`: a term of h in Eq. 10 and 11.
fn height(middle: DVec3, normal: DVec3, neighbour: DVec3, neighbour_normal: DVec3) -> f64 {
    let agreement = (1.0 + neighbour_normal.dot(normal)).max(LEAST_AGREEMENT);
    (neighbour_normal + normal).dot(neighbour - middle) / agreement
}

/// A new vertex for every edge (Eq. 9 and 11); [`refine_rims`] puts those of circles in their place.
fn add_edge_vertices(coarse: &Surface, fine: &mut Surface) {
    for edge in &coarse.edges {
        let [a, b] = edge.ends.map(|end| end as usize);
        // On a circle, for the time being, the middle.
        let beside = if edge.is_rim() { edge.ends } else { edge.opposite };
        let [c, d] = beside.map(|corner| corner as usize);
        let (points, normals) = (&coarse.points, &coarse.normals);
        let middle = (points[a] + points[b]) * END + (points[c] + points[d]) * OPPOSITE;
        let normal = unit_or((normals[a] + normals[b]) * END + (normals[c] + normals[d]) * OPPOSITE, normals[a]);
        let rise = |of: usize| height(middle, normal, points[of], normals[of]);
        let height = (rise(a) + rise(b)) * END + (rise(c) + rise(d)) * OPPOSITE;
        fine.points.push(middle + normal * height);
        fine.normals.push(normal);
    }
}

/// Divides the circles: a new vertex lies in the middle of the shorter arc (Eq. 6).
fn refine_rims(coarse: &Surface, axes: &[DVec3], cuts: &[f64], fine: &mut Surface) {
    let vertices = coarse.points.len() as u32;
    fine.rim_starts.extend(coarse.rim_starts.iter().map(|start| 2 * start));
    for (strut, (axis, cut)) in axes.iter().zip(cuts).enumerate() {
        let rim = coarse.rim_starts[strut] as usize..coarse.rim_starts[strut + 1] as usize;
        for (edge, vertex) in coarse.rim_edges[rim.clone()].iter().zip(&coarse.rim_vertices[rim]) {
            let [a, b] = coarse.edges[*edge as usize].ends.map(|end| coarse.normals[end as usize]);
            let radial = unit_or(across(a + b, *axis), a);
            let new = vertices + edge;
            fine.points[new as usize] = *axis * *cut + radial;
            fine.normals[new as usize] = radial;
            fine.rim_vertices.extend([*vertex, new]);
            // Edges of circles run counter-clockwise, so their first half comes first.
            fine.rim_edges.extend([2 * edge, 2 * edge + 1]);
        }
    }
}

/// The four parts of a triangle: one at each corner, and the one between. Edge e becomes edges 2e, at its first end, and 2e + 1; behind
/// all of these come three inner edges for each triangle, one near each corner.
fn divided(number: u32, triangle: &Triangle, vertices: u32, edges: &[Edge]) -> [Triangle; 4] {
    let Triangle { corners, sides } = triangle;
    let half = |side: usize, corner: usize| {
        let is_second = edges[sides[side] as usize].ends[0] != corners[corner];
        2 * sides[side] + u32::from(is_second)
    };
    let inner = |corner: usize| 2 * edges.len() as u32 + 3 * number + corner as u32;
    let middle = |side: usize| vertices + sides[side];
    let at_corner = |corner: usize| {
        let before = (corner + 2) % 3;
        Triangle {
            corners: [corners[corner], middle(corner), middle(before)],
            sides: [half(corner, corner), inner(corner), half(before, corner)],
        }
    };
    let between = Triangle { corners: [0, 1, 2].map(middle), sides: [inner(1), inner(2), inner(0)] };
    [at_corner(0), at_corner(1), at_corner(2), between]
}

/// The edges of the fine mesh, in the order that [`divided`] numbers them.
fn add_edges(coarse: &Surface, fine: &mut Surface) {
    let vertices = coarse.points.len() as u32;
    for (number, edge) in (0..).zip(&coarse.edges) {
        let middle = vertices + number;
        fine.edges.extend([Edge::new(edge.ends[0], middle), Edge::new(middle, edge.ends[1])]);
    }
    for triangle in &coarse.triangles {
        let middle = |side: usize| vertices + triangle.sides[side];
        fine.edges.extend([0, 1, 2].map(|corner| Edge::new(middle(corner), middle((corner + 2) % 3))));
    }
}
