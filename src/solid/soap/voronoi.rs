//! The spherical Voronoi diagram of the struts' directions (Luo & Zou 2025, §3.3.1), and the ghost directions that fill wide gaps between
//! them. `film` bends its edges.
//!
//! A vertex of the diagram is the centre of a circle on the sphere that passes through three directions or more and surrounds none. All
//! triples are tried, because this needs no special case for directions in one plane, on one circle or in one half of the sphere. Vertices
//! that are nearly equal become one, so that symmetric nodes have no slivers. Nothing is assumed of the result: the loops of all cells are
//! checked against each other in `film`.

use glam::DVec3;

use super::{across, unit_or};

/// Directions lie on a circle if they are that close to its plane, in radii of the sphere. Coordinates of real parts are rounded to a share
/// of some 1e-6 of the length of a strut; what this is too small for, [`SAME`] catches.
const ON_CIRCLE: f64 = 1e-9;

/// Cosine of 3°: neighbouring vertices that are closer become one.
const SAME: f64 = 0.998_629_534_754_573_9;

/// An empty circle whose plane is nearer to the centre of the sphere (75° wide and more) gets a ghost direction in its middle. Four struts
/// to the corners of a tetrahedron, whose circles lie at 1/3, need none.
const WIDE: f64 = 0.26;

/// Circles that differ less in [`Circle::height`] are equally wide; the first one gets the ghost.
const EQUALLY_WIDE: f64 = 1e-9;

/// Ghosts are at least 75° from each other and from all struts. No more than 7 directions have such distances, so this ends the search
/// only if rounding went wrong.
const MAX_GHOSTS: usize = 16;

/// An empty circle on the sphere.
#[derive(Clone, Copy, Debug)]
struct Circle {
    centre: DVec3,
    /// Of its plane above the centre of the sphere, towards `centre`.
    height: f64,
    /// The sites on it, a bit for each.
    on: u128,
}

/// A Voronoi diagram; it can be filled again.
#[derive(Debug, Default)]
pub(super) struct Voronoi {
    /// The struts' directions, then those of ghosts.
    pub(super) sites: Vec<DVec3>,
    /// Number of struts.
    pub(super) struts: usize,
    /// The vertices, unit vectors.
    pub(super) vertices: Vec<DVec3>,
    /// Sites around each vertex, a bit for each.
    around: Vec<u128>,
    circles: Vec<Circle>,
    /// For each circle, the first of those that become one vertex with it.
    same: Vec<usize>,
}

impl Voronoi {
    /// Fills it for the directions of two struts or more; at most [`super::Node::MAX_STRUTS`], so that a bit for each site fits in 128.
    pub(super) fn fill(&mut self, directions: impl Iterator<Item = DVec3>) {
        self.circles.clear();
        self.sites.clear();
        self.sites.extend(directions);
        self.struts = self.sites.len();
        if let [a, b] = self.sites[..] {
            // No circle passes through two sites only. The middle of the gap is where a third would have put it.
            self.sites.push(unit_or(-(a + b), a.any_orthonormal_vector()));
        }
        for third in 2..self.sites.len() {
            self.add_circles(third);
        }
        while let Some(ghost) = self.widest_gap().filter(|_| self.sites.len() < self.struts + MAX_GHOSTS) {
            self.add_ghost(ghost);
        }
        self.merge();
    }

    /// The middle of the widest empty circle, if it is too wide for a film.
    fn widest_gap(&self) -> Option<DVec3> {
        let lowest = self.circles.iter().map(|circle| circle.height).fold(f64::INFINITY, f64::min);
        let circle = self.circles.iter().find(|circle| circle.height <= lowest + EQUALLY_WIDE)?;
        (circle.height < WIDE).then_some(circle.centre)
    }

    fn add_ghost(&mut self, ghost: DVec3) {
        let bit = 1 << self.sites.len();
        self.sites.push(ghost);
        self.circles.retain(|circle| circle.centre.dot(ghost) <= circle.height + ON_CIRCLE);
        for circle in &mut self.circles {
            if circle.centre.dot(ghost) >= circle.height - ON_CIRCLE {
                circle.on |= bit;
            }
        }
        self.add_circles(self.sites.len() - 1);
    }

    /// Adds the empty circles through site `third` and two sites before it.
    fn add_circles(&mut self, third: usize) {
        for second in 1..third {
            for first in 0..second {
                self.add_circle([first, second, third]);
            }
        }
    }

    /// Adds the circle through three sites, from either side from which it surrounds no site.
    fn add_circle(&mut self, through: [usize; 3]) {
        let [a, b, c] = through.map(|site| self.sites[site]);
        let normal = (b - a).cross(c - a);
        let length = normal.length();
        // Three points of the sphere that are 10° apart and more span at least 0.003.
        if length < 1e-6 {
            return;
        }
        let normal = normal / length;
        let height = normal.dot(a);
        let (mut is_empty, mut is_empty_behind) = (true, true);
        for site in &self.sites {
            let above = normal.dot(*site) - height;
            is_empty &= above <= ON_CIRCLE;
            is_empty_behind &= above >= -ON_CIRCLE;
            if !is_empty && !is_empty_behind {
                return;
            }
        }
        if is_empty {
            self.push(normal, height);
        }
        if is_empty_behind {
            self.push(-normal, -height);
        }
    }

    /// Adds an empty circle unless it was found through other sites.
    fn push(&mut self, centre: DVec3, height: f64) {
        let sites = self.sites.iter().enumerate().filter(|(_, site)| centre.dot(**site) >= height - ON_CIRCLE);
        let on = sites.fold(0, |on, (site, _)| on | 1 << site);
        if !self.circles.iter().any(|known| known.on == on && known.centre.dot(centre) > 0.0) {
            self.circles.push(Circle { centre, height, on });
        }
    }

    /// Makes the vertices: each is the middle of circles that are nearly equal to the first of them, and share two sites with another, as
    /// neighbours do. Chains of neighbours do not become one, for this would move vertices too far.
    fn merge(&mut self) {
        self.same.clear();
        for (at, circle) in self.circles.iter().enumerate() {
            let is_same = |before: &usize| {
                let (other, first) = (self.circles[*before], self.circles[self.same[*before]]);
                (circle.on & other.on).count_ones() >= 2 && circle.centre.dot(first.centre) > SAME
            };
            let first = (0..at).find(is_same).map_or(at, |before| self.same[before]);
            self.same.push(first);
        }
        self.vertices.clear();
        self.around.clear();
        for first in (0..self.circles.len()).filter(|at| self.same[*at] == *at) {
            let (mut sum, mut on) = (DVec3::ZERO, 0);
            for (circle, _) in self.circles.iter().zip(&self.same).filter(|(_, same)| **same == first) {
                sum += circle.centre;
                on |= circle.on;
            }
            self.vertices.push(unit_or(sum, self.circles[first].centre));
            self.around.push(on);
        }
    }

    /// The other cell beside the edge between two vertices of a cell.
    pub(super) fn neighbour(&self, cell: usize, from: u32, to: u32) -> Option<usize> {
        let both = self.around[from as usize] & self.around[to as usize] & !(1 << cell);
        // Of several, which merged vertices may have, the one whose bisector the middle of the edge is nearest to.
        let middle = self.vertices[from as usize] + self.vertices[to as usize];
        let shared = (0..self.sites.len()).filter(|site| both & (1 << site) != 0);
        shared.max_by(|a, b| self.sites[*a].dot(middle).total_cmp(&self.sites[*b].dot(middle)))
    }

    /// Fills `corners` with the vertices around a site, counter-clockwise as seen from outside.
    pub(super) fn cell(&self, site: usize, corners: &mut Vec<(f64, u32)>) {
        let axis = self.sites[site];
        let [x, y] = [axis.any_orthonormal_vector(), axis.cross(axis.any_orthonormal_vector())];
        corners.clear();
        for (vertex, (direction, around)) in self.vertices.iter().zip(&self.around).enumerate() {
            if around & (1 << site) != 0 {
                let flat = across(*direction, axis);
                corners.push((turn(flat.dot(x), flat.dot(y)), vertex as u32));
            }
        }
        corners.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    }
}

/// A number that grows with the angle of (x, y) from the x axis, from −2 to 2, without trigonometry.
fn turn(x: f64, y: f64) -> f64 {
    let sum = x.abs() + y.abs();
    // No vertex lies on the axis of a cell; rounding errors go to `film`, which checks the loops.
    let along = if sum > 0.0 { x / sum } else { 1.0 };
    if y < 0.0 { along - 1.0 } else { 1.0 - along }
}
