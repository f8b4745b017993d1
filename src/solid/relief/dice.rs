//! Divides patches where they may reach some planes. `slice/body/surface/slabs.rs` hands their facets on to be cut; `tests/relief/` prints them.

use glam::DVec3;

use super::grid::{Grid, MAX_PIECES};
use super::patch::{EDGES, Off, PatchShape, Point, largest_share};
use crate::solid::mesh::Facet;

/// Smallest part of an edge of a patch that is divided in its middle: 2⁻¹¹ of it. With [`MAX_PIECES`], the smallest facet of an edge of a
/// third of a metre is 20 µm long.
const SMALLEST_SHARE: f64 = 1.0 / 2048.0;

/// How finely patches are divided.
///
/// An edge longer than [`MAX_PIECES`] facets is divided in its middle, and the parts between such edges likewise. What is left of an edge
/// is divided into 1, 2, 4 … equal pieces: the fewest that are straight or short enough. That depends on the edge alone, so that neighbours
/// agree. A part whose edges are all short is divided by a `Grid`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dicing {
    /// One over the longest edge of a facet along x, y and z, before it is displaced; per quantum.
    scale: DVec3,
    /// How far a facet may be from what it stands for, quanta. One with shorter edges may be farther.
    tolerance: f64,
}

impl Dicing {
    /// Facets are at most `tolerance` quanta from what they stand for, or have edges of at most `longest` along each axis.
    pub(crate) fn new(longest: [f64; 3], tolerance: f64) -> Self {
        Self { scale: DVec3::from(longest).recip(), tolerance }
    }

    /// Length of an edge, in facets.
    fn length(&self, a: &Point, b: &Point) -> f64 {
        ((a.flat - b.flat) * self.scale).length()
    }

    /// Whether an edge is divided in its middle.
    fn halves(&self, a: &Point, b: &Point) -> bool {
        self.length(a, b) > MAX_PIECES as f64 && largest_share([a, b, b]) > SMALLEST_SHARE
    }

    /// The number of pieces of an edge that is not divided in its middle.
    fn edge_pieces(&self, patch: &PatchShape<'_>, a: &Point, b: &Point) -> usize {
        let length = self.length(a, b);
        // A short one need not be looked at.
        if length <= 1.0 { 1 } else { self.pieces(length, &patch.off(a, b)) }
    }

    /// The number of pieces of a line of this length.
    fn pieces(&self, length: f64, off: &Off) -> usize {
        let mut count = 1;
        while count < MAX_PIECES && length > count as f64 && off.of_pieces(count) > self.tolerance {
            count *= 2;
        }
        count
    }
}

/// What is wanted of a patch.
trait Seeker {
    /// Whether the facets of a patch must meet those of its neighbours. If not, a part that is flat enough is one facet, however long.
    const MEETS_NEIGHBOURS: bool;

    /// Whether a part in this box may be of interest.
    fn wants(&mut self, bounds: [DVec3; 2]) -> bool;

    /// A bit for each side on which a point lies beyond what is of interest. A facet is of none if all its corners lie beyond the same side.
    fn beyond(&self, point: DVec3) -> u8;

    /// Takes a facet, counter-clockwise seen from outside.
    fn take(&mut self, facet: Facet);
}

/// The part of space in which facets matter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    /// Lowest and highest y.
    pub(crate) y: [f64; 2],
    /// Lowest and highest z.
    pub(crate) z: [f64; 2],
}

impl Window {
    /// A bit for each side of the window beyond which a point lies.
    fn beyond(&self, [_, y, z]: [f64; 3]) -> u8 {
        let sides = [y < self.y[0], y > self.y[1], z < self.z[0], z > self.z[1]];
        sides.into_iter().rev().fold(0, |bits, is_beyond| bits << 1 | u8::from(is_beyond))
    }

    /// Whether the box around a facet reaches into it.
    pub(crate) fn meets(&self, [a, b, c]: &Facet) -> bool {
        self.beyond(*a) & self.beyond(*b) & self.beyond(*c) == 0
    }
}

/// Hands on the facets that a window meets, until `take` returns false.
struct InWindow<F> {
    window: Window,
    take: F,
    goes_on: bool,
}

impl<F: FnMut(&Facet) -> bool> Seeker for InWindow<F> {
    const MEETS_NEIGHBOURS: bool = true;

    fn wants(&mut self, [low, high]: [DVec3; 2]) -> bool {
        let Window { y, z } = self.window;
        self.goes_on && low.z <= z[1] && high.z >= z[0] && low.y <= y[1] && high.y >= y[0]
    }

    fn beyond(&self, point: DVec3) -> u8 {
        self.window.beyond(point.to_array())
    }

    fn take(&mut self, facet: Facet) {
        self.goes_on = self.goes_on && (self.take)(&facet);
    }
}

/// A box around all facets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent {
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
    /// How many more parts are divided.
    parts_left: u32,
}

impl Extent {
    /// A box around nothing. It divides at most `parts` parts.
    pub(crate) fn new(parts: u32) -> Self {
        Self { low: DVec3::MAX, high: DVec3::MIN, parts_left: parts }
    }

    /// Whether it divides no more parts, and facets may lie outside.
    pub(crate) fn is_spent(&self) -> bool {
        self.parts_left == 0
    }

    /// Extends the box to the corners of a patch.
    pub(crate) fn extend_to_corners(&mut self, patch: &PatchShape<'_>) {
        self.take(patch.ends().map(|end| end.at.to_array()));
    }

    /// Extends the box to the facets of a patch. Only parts that may leave it are divided.
    pub(crate) fn extend(&mut self, patch: &PatchShape<'_>, dicing: &Dicing) {
        patch.dice(dicing, self);
    }
}

impl Seeker for Extent {
    const MEETS_NEIGHBOURS: bool = false;

    fn wants(&mut self, [low, high]: [DVec3; 2]) -> bool {
        if !(low.cmplt(self.low).any() || high.cmpgt(self.high).any()) || self.is_spent() {
            return false;
        }
        self.parts_left -= 1;
        true
    }

    fn beyond(&self, _point: DVec3) -> u8 {
        0
    }

    fn take(&mut self, facet: Facet) {
        for corner in facet.map(DVec3::from) {
            (self.low, self.high) = (self.low.min(corner), self.high.max(corner));
        }
    }
}

impl PatchShape<'_> {
    /// Hands on the facets of a patch that a window meets, counter-clockwise seen from outside, until `take` returns false. Returns whether it
    /// did not.
    pub(crate) fn facets(&self, dicing: &Dicing, window: Window, take: impl FnMut(&Facet) -> bool) -> bool {
        let mut seeker = InWindow { window, take, goes_on: true };
        self.dice(dicing, &mut seeker);
        seeker.goes_on
    }

    fn dice(&self, dicing: &Dicing, seeker: &mut impl Seeker) {
        let ends = self.ends();
        let mut dicer = Dicer { patch: self, dicing, seeker, is_reversed: false };
        dicer.part([&ends[0], &ends[1], &ends[2]]);
        if self.is_plain() {
            return;
        }
        for (edge, [from, to]) in EDGES.into_iter().enumerate() {
            if self.seams[edge] {
                // The patch runs along the last edge from its second corner to its first.
                dicer.is_reversed = edge == 2;
                dicer.wall(&ends[from], &ends[to]);
            }
        }
    }
}

/// Divides one patch.
struct Dicer<'a, S> {
    patch: &'a PatchShape<'a>,
    dicing: &'a Dicing,
    seeker: &'a mut S,
    /// Whether facets run clockwise along the corners of the patch.
    is_reversed: bool,
}

impl<S: Seeker> Dicer<'_, S> {
    /// The part between three points, in the order of the corners of the patch.
    fn part(&mut self, points: [&Point; 3]) {
        let [a, b, c] = points;
        let Self { patch, dicing, .. } = self;
        if patch.is_flat() {
            return self.take([a.at, b.at, c.at]);
        }
        let part = patch.part(points, 0);
        if !self.seeker.wants(part.bounds) {
            return;
        }
        if !S::MEETS_NEIGHBOURS && part.off.of_pieces(1) <= dicing.tolerance {
            return self.take([a.at, b.at, c.at]);
        }
        let halves = [(a, b), (b, c), (c, a)].map(|(from, to)| dicing.halves(from, to));
        let between = |from: &Point, to: &Point| self.patch.between(from, to);
        match halves.iter().filter(|halves| **halves).count() {
            3 => {
                let (ab, bc, ca) = (between(a, b), between(b, c), between(c, a));
                for part in [[a, &ab, &ca], [&ab, b, &bc], [&ca, &bc, c], [&ab, &bc, &ca]] {
                    self.part(part);
                }
            }
            2 => {
                // Turned so that the edges at b are divided.
                let [a, b, c] = turned(points, halves.map(|halves| !halves), 2);
                let (ab, bc) = (between(a, b), between(b, c));
                for part in [[a, &ab, c], [&ab, b, &bc], [&ab, &bc, c]] {
                    self.part(part);
                }
            }
            1 => {
                let [a, b, c] = turned(points, halves, 0);
                let ab = between(a, b);
                for part in [[a, &ab, c], [&ab, b, c]] {
                    self.part(part);
                }
            }
            _ => self.grid(points, &part.off),
        }
    }

    /// A part that is not divided in the middle of any edge.
    fn grid(&mut self, points: [&Point; 3], off: &Off) {
        let [a, b, c] = points;
        let Self { patch, dicing, .. } = self;
        let edges = [(a, b), (b, c), (c, a)];
        let longest = edges.map(|(from, to)| dicing.length(from, to)).into_iter().fold(0.0, f64::max);
        // No edge needs more pieces than the part: it is shorter, and no farther from straight.
        let inner = dicing.pieces(longest, off);
        let pieces = match inner {
            1 => [1; 3],
            _ => edges.map(|(from, to)| dicing.edge_pieces(patch, from, to)),
        };
        let grid = Grid::new(inner, pieces);
        let placed = |at: DVec3| (at, self.seeker.beyond(at));
        let ends = points.map(|point| placed(point.at));
        let points = grid.points(ends, |shares| placed(patch.point(mixed(points, shares)).at));
        grid.facets(&points, |facet| self.take_placed(facet));
    }

    /// What joins a displaced edge of the patch to the edge itself: what lies between the ends of both, and then the border.
    fn wall(&mut self, from: &Point, to: &Point) {
        let [a, b] = [from.flat, to.flat];
        self.take([a, b, to.at]);
        self.take([a, to.at, from.at]);
        self.border(from, to);
    }

    /// What lies between a displaced edge and the line between two of its points.
    fn border(&mut self, from: &Point, to: &Point) {
        if self.patch.is_flat() || !self.seeker.wants(self.patch.part([from, to, to], 0).bounds) {
            return;
        }
        if self.dicing.halves(from, to) {
            let middle = self.patch.between(from, to);
            self.take([from.at, to.at, middle.at]);
            self.border(from, &middle);
            self.border(&middle, to);
        } else {
            self.pieces(from, to, self.dicing.edge_pieces(self.patch, from, to));
        }
    }

    /// What lies between so many pieces of an edge and the line between its ends.
    fn pieces(&mut self, from: &Point, to: &Point, count: usize) {
        if count > 1 {
            let middle = self.patch.between(from, to);
            self.take([from.at, to.at, middle.at]);
            self.pieces(from, &middle, count / 2);
            self.pieces(&middle, to, count / 2);
        }
    }

    fn take(&mut self, facet: [DVec3; 3]) {
        self.take_placed(facet.map(|corner| (corner, self.seeker.beyond(corner))));
    }

    /// Takes a facet. Beside each corner stands what it is beyond.
    fn take_placed(&mut self, [a, b, c]: [(DVec3, u8); 3]) {
        if a.1 & b.1 & c.1 == 0 {
            let [a, b, c] = [a, b, c].map(|(corner, _)| corner.to_array());
            self.seeker.take(if self.patch.is_turned == self.is_reversed { [a, b, c] } else { [a, c, b] });
        }
    }
}

/// Weights of the point with these shares of three others.
fn mixed([a, b, c]: [&Point; 3], [from_a, from_b, from_c]: [f64; 3]) -> [f64; 3] {
    // Exact: all are fractions with a denominator of a power of two.
    [0, 1, 2].map(|corner| a.weights[corner] * from_a + b.weights[corner] * from_b + c.weights[corner] * from_c)
}

/// `points`, turned so that the edge of which `is_that` is true becomes edge number `place`. There is one such edge.
fn turned(mut points: [&Point; 3], is_that: [bool; 3], place: usize) -> [&Point; 3] {
    let edge = is_that.iter().position(|is_that| *is_that).unwrap_or(place);
    points.rotate_left((edge + 3 - place) % 3);
    points
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DMat3;

    use super::super::{HeightMap, Lift, PatchCorner, Tile};
    use super::*;

    #[test]
    fn bounds_of_a_rough_patch_are_found_or_given_up() {
        // One texel rises above the others.
        let texel = |number: u32| if number == 40 * 64 + 10 { 30_000 } else { (number * 37 % 1000) as u16 };
        let texels = (0..64 * 64).map(texel).collect();
        let map = Arc::new(HeightMap::new([64, 64], [Tile::Wrap; 2], true, texels));
        let lift = Lift::new(map, 65_535.0, 0.0, DMat3::IDENTITY);
        let corner = |u: f64, v: f64| PatchCorner {
            at: DVec3::new(1000.0 * u, 1000.0 * v, 0.0),
            direction: DVec3::Z,
            texture: [u, v],
            factor: 1.0,
        };
        let corners = [corner(0.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0)];
        let patch = PatchShape::new(corners, [false; 3], Some(&lift), false);
        let dicing = Dicing::new([1.0; 3], 0.04);
        let mut extent = Extent::new(1 << 20);
        extent.extend(&patch, &dicing);
        assert!(!extent.is_spent());
        assert!((extent.high.z - 30_000.0).abs() < 1e-6, "{extent:?}");
        let mut extent = Extent::new(5);
        extent.extend(&patch, &dicing);
        assert!(extent.is_spent(), "{extent:?}");
    }
}
