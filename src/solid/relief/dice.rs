//! Divides patches where they may reach a plane. `slice/body/surface/element.rs` hands them on to be cut; `tests/relief/` prints them.

use glam::DVec3;

use super::patch::{EDGES, PatchShape, Point};
use crate::solid::mesh::Facet;

/// Smallest part of an edge of a patch: 2⁻¹⁴ of it. An edge of a third of a metre is then divided to 20 µm.
const SMALLEST_SHARE: f64 = 1.0 / 16_384.0;

/// How finely patches are divided.
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

    /// Whether an edge is so long that it may have to be divided.
    fn is_long(&self, a: &Point, b: &Point) -> bool {
        let share = |corner: usize| (a.weights[corner] - b.weights[corner]).abs();
        share(0).max(share(1)).max(share(2)) > SMALLEST_SHARE && ((a.flat - b.flat) * self.scale).length_squared() > 1.0
    }

    /// Whether an edge is divided. It depends on the edge alone, so that neighbours agree.
    fn divides(&self, patch: &PatchShape<'_>, a: &Point, b: &Point) -> bool {
        self.is_long(a, b) && patch.off(a, b) > self.tolerance
    }
}

/// What is wanted of a patch.
trait Seeker {
    /// Whether a part in this box may be of interest.
    fn wants(&self, bounds: [DVec3; 2]) -> bool;

    /// Takes a facet, counter-clockwise seen from outside. It may be of no interest.
    fn take(&mut self, facet: Facet);
}

/// The part of space in which facets matter: a plane, and a range of y on it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    /// Height of the plane.
    pub(crate) z: f64,
    /// Lowest and highest y.
    pub(crate) y: [f64; 2],
}

/// Hands on the facets that may be in a window.
struct InWindow<F> {
    window: Window,
    take: F,
}

impl<F: FnMut(&Facet)> Seeker for InWindow<F> {
    fn wants(&self, [low, high]: [DVec3; 2]) -> bool {
        let Window { z, y } = self.window;
        low.z <= z && high.z >= z && low.y <= y[1] && high.y >= y[0]
    }

    fn take(&mut self, facet: Facet) {
        (self.take)(&facet);
    }
}

/// A box around all facets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent {
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
}

impl Extent {
    /// A box around nothing.
    pub(crate) const EMPTY: Self = Self { low: DVec3::MAX, high: DVec3::MIN };

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
    fn wants(&self, [low, high]: [DVec3; 2]) -> bool {
        low.cmplt(self.low).any() || high.cmpgt(self.high).any()
    }

    fn take(&mut self, facet: Facet) {
        for corner in facet.map(DVec3::from) {
            (self.low, self.high) = (self.low.min(corner), self.high.max(corner));
        }
    }
}

impl PatchShape<'_> {
    /// Hands on the facets of a patch that may be in a window, counter-clockwise seen from outside.
    pub(crate) fn facets(&self, dicing: &Dicing, window: Window, take: impl FnMut(&Facet)) {
        self.dice(dicing, &mut InWindow { window, take });
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
        let is_whole = patch.is_flat() || !(dicing.is_long(a, b) || dicing.is_long(b, c) || dicing.is_long(c, a));
        if is_whole {
            return self.take([a.at, b.at, c.at]);
        }
        let part = patch.part(points, 0);
        if !self.seeker.wants(part.bounds) {
            return;
        }
        // No edge is farther from flat than the part.
        if part.off <= dicing.tolerance {
            return self.take([a.at, b.at, c.at]);
        }
        let divides = [(a, b), (b, c), (c, a)].map(|(from, to)| dicing.divides(patch, from, to));
        let between = |from: &Point, to: &Point| self.patch.between(from, to);
        match divides.iter().filter(|divides| **divides).count() {
            3 => {
                let (ab, bc, ca) = (between(a, b), between(b, c), between(c, a));
                for part in [[a, &ab, &ca], [&ab, b, &bc], [&ca, &bc, c], [&ab, &bc, &ca]] {
                    self.part(part);
                }
            }
            2 => {
                // Turned so that the edges at b are divided.
                let [a, b, c] = turned(points, divides.map(|divides| !divides), 2);
                let (ab, bc) = (between(a, b), between(b, c));
                for part in [[a, &ab, c], [&ab, b, &bc], [&ab, &bc, c]] {
                    self.part(part);
                }
            }
            1 => {
                let [a, b, c] = turned(points, divides, 0);
                let ab = between(a, b);
                for part in [[a, &ab, c], [&ab, b, c]] {
                    self.part(part);
                }
            }
            _ => self.take([a.at, b.at, c.at]),
        }
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
        if self.patch.is_flat()
            || !self.dicing.divides(self.patch, from, to)
            || !self.seeker.wants(self.patch.part([from, to, to], 0).bounds)
        {
            return;
        }
        let middle = self.patch.between(from, to);
        self.take([from.at, to.at, middle.at]);
        self.border(from, &middle);
        self.border(&middle, to);
    }

    fn take(&mut self, facet: [DVec3; 3]) {
        let [a, b, c] = facet.map(|corner| corner.to_array());
        self.seeker.take(if self.patch.is_turned == self.is_reversed { [a, b, c] } else { [a, c, b] });
    }
}

/// `points`, turned so that the edge of which `is_that` is true becomes edge number `place`. There is one such edge.
fn turned(mut points: [&Point; 3], is_that: [bool; 3], place: usize) -> [&Point; 3] {
    let edge = is_that.iter().position(|is_that| *is_that).unwrap_or(place);
    points.rotate_left((edge + 3 - place) % 3);
    points
}
