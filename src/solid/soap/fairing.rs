//! Fairing: the film and the row beside it move to where the bi-Laplacian of the control mesh vanishes, almost (Luo & Zou 2025, Eq. 2 and
//! §3.3.2). `node` calls it; `tests/nodes/` shows what it does.
//!
//! With A, the adjacency of the mesh without diagonals, D, its degrees, and K = D − A, the equation `(D⁻¹K)²X = 0` becomes
//! `(K D⁻¹ K + HD) X = HD X⁰` for the free vertices, where H, a diagonal, holds them near X⁰. It is symmetric and positive definite. With
//! X = X⁰ + Δ it is `(K D⁻¹ K + HD) Δ = −K D⁻¹ K X⁰`, and conjugate gradients find Δ for all three coordinates at once. The matrix is
//! never stored: K is applied twice.

use glam::DVec3;

use super::surface::Edge;

/// How strongly vertices are held where they were, beside creases between struts, which are to become round. The paper has 0.
const HOLD_CREASED: f64 = 0.02;

/// The same where struts and ball are smooth already: on the outside of elbows and over wide gaps, which would sink and leave a tip in the
/// middle. The paper has no such nodes. With less a dent remains; more changes little.
const HOLD_SMOOTH: f64 = 2.0;

/// The search ends once the square of the residual is that share of the square of the first. Vertices are then within some 1e-6 radii: less
/// than a thousandth of the error of the finest level that is needed.
const SMALL: f64 = 1e-12;

/// Regular nodes take some 10 steps and others 50. This ends the search if rounding went wrong.
const MOST_STEPS: usize = 200;

/// Which vertices may move.
#[derive(Debug, Default)]
pub(super) struct Free {
    /// The first one; all behind it may move.
    pub(super) first: usize,
    /// The first of the fixed vertices just before it that have free neighbours.
    pub(super) beside: usize,
    /// For each free vertex, whether struts form a crease there.
    pub(super) creased: Vec<bool>,
}

/// Fairing with its buffers. Vertices are numbered as in the mesh; the free ones come last.
#[derive(Debug, Default)]
pub(super) struct Fairing {
    /// Neighbours of all vertices, and where those of each begin.
    neighbours: Vec<u32>,
    starts: Vec<u32>,
    /// Reciprocal of the number of neighbours.
    shares: Vec<f64>,
    degrees: Vec<f64>,
    /// H D of the free vertices.
    held: Vec<f64>,
    /// `D⁻¹K` of a vector.
    laplacian: Vec<DVec3>,
    residual: Vec<DVec3>,
    /// 0 for vertices that are not free.
    direction: Vec<DVec3>,
    image: Vec<DVec3>,
}

impl Fairing {
    /// Moves the free ones of the `points`. `edges` are those of the mesh without diagonals.
    pub(super) fn fair(&mut self, points: &mut [DVec3], edges: &[Edge], free: &Free) {
        self.join(points.len(), edges);
        let holds = free.creased.iter().map(|creased| if *creased { HOLD_CREASED } else { HOLD_SMOOTH });
        self.held.clear();
        self.held.extend(self.degrees[free.first..].iter().zip(holds).map(|(degree, hold)| degree * hold));
        for column in [&mut self.residual, &mut self.direction, &mut self.image, &mut self.laplacian] {
            column.clear();
            column.resize(points.len(), DVec3::ZERO);
        }
        self.direction.copy_from_slice(points);
        self.apply(free);
        for (residual, image) in self.residual.iter_mut().zip(&self.image) {
            *residual = -*image;
        }
        self.direction.fill(DVec3::ZERO);
        self.solve(free, points);
    }

    /// Lists the neighbours of all vertices.
    fn join(&mut self, vertices: usize, edges: &[Edge]) {
        self.starts.clear();
        self.starts.resize(vertices + 1, 0);
        edges.iter().flat_map(|edge| edge.ends).for_each(|end| self.starts[end as usize + 1] += 1);
        self.degrees.clear();
        self.degrees.extend(self.starts[1..].iter().map(|degree| f64::from(*degree)));
        self.shares.clear();
        self.shares.extend(self.degrees.iter().map(|degree| 1.0 / degree));
        for vertex in 0..vertices {
            self.starts[vertex + 1] += self.starts[vertex];
        }
        self.neighbours.clear();
        self.neighbours.resize(2 * edges.len(), 0);
        for [from, to] in edges.iter().flat_map(|edge| [edge.ends, [edge.ends[1], edge.ends[0]]]) {
            // Each vertex fills its part from its start, which moves on to the next one's.
            self.neighbours[self.starts[from as usize] as usize] = to;
            self.starts[from as usize] += 1;
        }
        self.starts.rotate_right(1);
        self.starts[0] = 0;
    }

    /// Sum over the neighbours of a vertex.
    fn sum(&self, vertex: usize, of: &[DVec3]) -> DVec3 {
        let neighbours = &self.neighbours[self.starts[vertex] as usize..self.starts[vertex + 1] as usize];
        neighbours.iter().map(|neighbour| of[*neighbour as usize]).sum()
    }

    /// `K D⁻¹ K` of the direction, for the free vertices.
    fn apply(&mut self, free: &Free) {
        for vertex in free.beside..self.direction.len() {
            self.laplacian[vertex] = self.direction[vertex] - self.sum(vertex, &self.direction) * self.shares[vertex];
        }
        for vertex in free.first..self.direction.len() {
            self.image[vertex] = self.laplacian[vertex] * self.degrees[vertex] - self.sum(vertex, &self.laplacian);
        }
    }

    /// Conjugate gradients, preconditioned with the degrees; each coordinate has its own steps.
    fn solve(&mut self, free: &Free, points: &mut [DVec3]) {
        let moving = free.first..points.len();
        for at in moving.clone() {
            self.direction[at] = self.residual[at] * self.shares[at];
        }
        let mut size: DVec3 = moving.clone().map(|at| self.residual[at] * self.direction[at]).sum();
        let enough = size.max_element() * SMALL;
        for _ in 0..MOST_STEPS {
            if size.max_element() <= enough {
                break;
            }
            self.apply(free);
            let mut curvature = DVec3::ZERO;
            for at in moving.clone() {
                self.image[at] += self.direction[at] * self.held[at - free.first];
                curvature += self.direction[at] * self.image[at];
            }
            let step = ratio(size, curvature);
            let mut next = DVec3::ZERO;
            for at in moving.clone() {
                points[at] += self.direction[at] * step;
                self.residual[at] -= self.image[at] * step;
                next += self.residual[at] * self.residual[at] * self.shares[at];
            }
            let keep = ratio(next, size);
            for at in moving.clone() {
                self.direction[at] = self.residual[at] * self.shares[at] + self.direction[at] * keep;
            }
            size = next;
        }
    }
}

/// `a / b` by coordinate; 0 where a coordinate is solved, and both are 0.
fn ratio(a: DVec3, b: DVec3) -> DVec3 {
    DVec3::from([0, 1, 2].map(|axis| if b[axis] > 0.0 { a[axis] / b[axis] } else { 0.0 }))
}
