//! A point of a patch, and a box around a part of one. `dice` divides patches; `buildfile/primitive/patch.rs` makes them.

use std::sync::Arc;

use glam::{DMat3, DVec3};

use super::curve::Curve;
use super::map::HeightMap;

/// Corners of the edges of a patch.
pub(super) const EDGES: [[usize; 2]; 3] = [[0, 1], [1, 2], [0, 2]];

/// Room for rounding around boxes, quanta: coordinates have 2³⁰ and 23 bits behind the point.
const ROUNDING: f64 = 1e-5;

/// A corner of a patch. Lengths are in quanta.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PatchCorner {
    pub(crate) at: DVec3,
    /// Where the surface is displaced to, of unit length. On a curved patch the normal.
    pub(crate) direction: DVec3,
    /// Texture coordinates.
    pub(crate) texture: [f64; 2],
    /// What the displacement is multiplied by.
    pub(crate) factor: f64,
}

impl PatchCorner {
    /// An order of corners in which equal ones are equal in every bit.
    fn key(&self) -> [f64; 9] {
        let Self { at, direction, texture: [u, v], factor } = self;
        [at.z, at.y, at.x, *u, *v, *factor, direction.z, direction.y, direction.x]
    }
}

/// How a map displaces: at a point with the unit direction n by `factor · (height · value + offset)` along `frame · n`.
#[derive(Clone, Debug)]
pub(crate) struct Lift {
    map: Arc<HeightMap>,
    /// Displacement where the map is 1, without the offset.
    height: f64,
    offset: f64,
    /// What a transformation of the displaced shape makes of directions.
    frame: DMat3,
    /// Along each axis, how far the frame takes a unit direction at most.
    reach: DVec3,
}

/// A patch as it is evaluated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatchShape<'a> {
    /// In the order of their keys, so that an edge is computed alike in both patches that share it.
    corners: [PatchCorner; 3],
    /// Whether that order runs clockwise, seen from outside.
    pub(super) is_turned: bool,
    /// Which edges are seams: those of [`EDGES`].
    pub(super) seams: [bool; 3],
    lift: Option<&'a Lift>,
    curve: Option<Curve>,
    /// How far all of it is moved inwards, against the direction.
    inset: f64,
}

/// A point of a patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    /// Shares of the corners.
    pub(super) weights: [f64; 3],
    /// On the flat triangle.
    pub(super) flat: DVec3,
    /// Before it is displaced.
    base: DVec3,
    direction: DVec3,
    texture: [f64; 2],
    factor: f64,
    /// Where it is.
    pub(super) at: DVec3,
}

impl<'a> PatchShape<'a> {
    /// A patch of these corners, counter-clockwise seen from outside. `seams` tells of the edges from each corner to the next whether the
    /// neighbour there has other directions, texture coordinates or displacements, or is missing.
    pub(crate) fn new(corners: [PatchCorner; 3], seams: [bool; 3], lift: Option<&'a Lift>, is_curved: bool) -> Self {
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| {
            let [a, b] = [a, b].map(|corner: &usize| corners[*corner].key());
            a.partial_cmp(&b).unwrap_or(std::cmp::Ordering::Equal)
        });
        let is_turned = (order[0] + 1) % 3 != order[1];
        // The edge between two corners is that of the one from which the other is next.
        let seam = |a: usize, b: usize| seams[if (a + 1) % 3 == b { a } else { b }];
        let seams = EDGES.map(|[a, b]| seam(order[a], order[b]));
        let corners = order.map(|corner| corners[corner]);
        let curve =
            is_curved.then(|| Curve::new(corners.map(|corner| corner.at), corners.map(|corner| corner.direction)));
        Self { corners, is_turned, seams, lift, curve, inset: 0.0 }
    }

    /// The same patch, moved inwards: the inner side of a shell.
    pub(crate) fn inner(self, thickness: f64) -> Self {
        Self { inset: thickness, is_turned: !self.is_turned, ..self }
    }

    /// Whether all of it is what its corners and edges say.
    pub(super) fn is_flat(&self) -> bool {
        self.lift.is_none() && self.curve.is_none()
    }

    /// Whether its edges lie on those of the flat triangle.
    pub(super) fn is_plain(&self) -> bool {
        self.is_flat() && self.inset == 0.0
    }

    /// Its corners.
    pub(super) fn ends(&self) -> [Point; 3] {
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|weights| self.point(weights))
    }

    /// The point in the middle of two.
    pub(super) fn between(&self, a: &Point, b: &Point) -> Point {
        let middle = |corner: usize| (a.weights[corner] + b.weights[corner]) / 2.0;
        self.point([middle(0), middle(1), middle(2)])
    }

    /// The point of these weights. On an edge it depends on the two corners there alone, bit for bit: what is multiplied by 0 adds 0.
    pub(super) fn point(&self, weights: [f64; 3]) -> Point {
        let [a, b, c] = &self.corners;
        let mix = |values: [f64; 3]| values[0] * weights[0] + values[1] * weights[1] + values[2] * weights[2];
        let flat = a.at * weights[0] + b.at * weights[1] + c.at * weights[2];
        let base = self.curve.map_or(flat, |curve| curve.point(weights));
        let sum = a.direction * weights[0] + b.direction * weights[1] + c.direction * weights[2];
        // Opposite directions have no middle; there is no displacement there.
        let direction = sum.normalize_or_zero();
        let texture = |axis: usize| mix([a.texture[axis], b.texture[axis], c.texture[axis]]);
        let texture = [texture(0), texture(1)];
        let factor = mix([a.factor, b.factor, c.factor]);
        let mut at = base;
        if let Some(Lift { map, height, offset, frame, .. }) = self.lift {
            if let Some(value) = map.sample(texture) {
                at += *frame * direction * ((height * value + offset) * factor);
            }
            if self.inset > 0.0 {
                at += self.inward(direction) * self.inset;
            }
        } else {
            // Not normalised: flat sides stay flat.
            at -= if self.curve.is_some() { direction } else { sum } * self.inset;
        }
        Point { weights, flat, base, direction, texture, factor, at }
    }

    /// A box around all of it and its walls, as low and high corners. The map is read in a margin of so many texels around it, so that the box holds for
    /// smoother versions of the map, too.
    pub(crate) fn bounds(&self, margin: i64) -> [DVec3; 2] {
        let ends = self.ends();
        let [mut low, mut high] = self.part([&ends[0], &ends[1], &ends[2]], margin).bounds;
        if self.seams != [false; 3] {
            // Walls begin at the edges themselves.
            for end in ends {
                (low, high) = (low.min(end.flat), high.max(end.flat));
            }
        }
        [low, high]
    }

    /// What is known of the part between three points, or of the line between two.
    pub(super) fn part(&self, points: [&Point; 3], margin: i64) -> Part {
        let [a, b, c] = points;
        let mut low = a.base.min(b.base).min(c.base);
        let mut high = a.base.max(b.base).max(c.base);
        let mut off = Off::default();
        if let Some(curve) = &self.curve {
            let bend = curve.bend() * largest_share(points).powi(2);
            (low, high) = (low - bend, high + bend);
            off.squared = bend;
        }
        if let Some(lift) = self.lift {
            let span = lift.span(points, margin);
            let (least, most) = lift.bounds(points, &span);
            lift.add_off(&mut off, &span);
            (low, high) = (low + least, high + most);
        }
        if self.inset > 0.0 {
            let inward = points.map(|point| self.inward(point.direction));
            let [least, most] = directions(inward, squared_chord(inward), DVec3::ONE);
            (low, high) = (low + least * self.inset, high + most * self.inset);
        }
        Part { bounds: [low - ROUNDING, high + ROUNDING], off }
    }

    /// Where the inner side of a shell lies, from a point of the outer side with this direction.
    fn inward(&self, direction: DVec3) -> DVec3 {
        -self.lift.map_or(direction, |lift| (lift.frame * direction).normalize_or_zero())
    }

    /// How far the line between two points may be from straight. On an edge of the patch, it depends on that edge alone.
    pub(super) fn off(&self, a: &Point, b: &Point) -> Off {
        let mut off = Off::default();
        if let Some(curve) = &self.curve {
            off.squared = curve.bend_between(a.weights, b.weights) * largest_share([a, b, b]).powi(2);
        }
        if let Some(lift) = self.lift {
            lift.add_off(&mut off, &lift.span([a, b, b], 0));
        }
        off
    }
}

/// Square of the longest chord between three directions.
fn squared_chord([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a))
}

/// The range of what lies between three directions of unit length, or of what a frame makes of them, whose reach it is. Directions between
/// three lie on the sphere among them: they rise above the highest by less than a quarter of the square of the longest chord.
fn directions([a, b, c]: [DVec3; 3], squared_chord: f64, reach: DVec3) -> [DVec3; 2] {
    let bulge = reach * (squared_chord / 4.0);
    [a.min(b).min(c) - bulge, a.max(b).max(c) + bulge]
}

/// By how much the weights of some points differ at most.
pub(super) fn largest_share([a, b, c]: [&Point; 3]) -> f64 {
    let share = |corner: usize| {
        let [a, b, c] = [a.weights[corner], b.weights[corner], c.weights[corner]];
        a.max(b).max(c) - a.min(b).min(c)
    };
    share(0).max(share(1)).max(share(2))
}

/// A part of a patch.
pub(super) struct Part {
    /// A box around it, as low and high corners.
    pub(super) bounds: [DVec3; 2],
    /// How far it is from flat. What follows from a shell being moved inwards is left out: it is as smooth as the outer side.
    pub(super) off: Off,
}

/// How far a line or a part may be from straight or flat, and its pieces if it is divided into equal ones.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Off {
    /// For pieces of any length.
    always: f64,
    /// The part that is proportional to the length of a piece.
    linear: f64,
    /// The part that is proportional to the square of that length.
    squared: f64,
    /// The bend between texels, as a displacement, and the number of texels along it.
    texel_bend: f64,
    texels: f64,
}

impl Off {
    /// The bound for each of so many pieces along an edge.
    pub(super) fn of_pieces(&self, count: usize) -> f64 {
        let share = 1.0 / count as f64;
        let texels = self.texels * share;
        // A piece of two texels has one bend in its middle.
        let bend = self.texel_bend * (texels * texels / 8.0).max(texels / 4.0);
        self.always + self.linear * share + self.squared * share * share + bend
    }
}

/// What is displaced between some points.
struct Span {
    /// How far values of the map may be from linear, whatever their distance; and the bend and number of the texels among them.
    always_off: f64,
    texel_bend: f64,
    texels: f64,
    /// Least and greatest displacement, without factors and with them.
    heights: [f64; 2],
    factors: [f64; 2],
    lengths: [f64; 2],
    /// Square of the longest chord between their directions.
    squared_chord: f64,
}

impl Lift {
    /// A displacement by `height` and `offset`, quanta.
    pub(crate) fn new(map: Arc<HeightMap>, height: f64, offset: f64, frame: DMat3) -> Self {
        let rows = frame.transpose();
        let reach = DVec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length());
        Self { map, height, offset, frame, reach }
    }

    fn span(&self, [a, b, c]: [&Point; 3], margin: i64) -> Span {
        let least = |axis: usize| a.texture[axis].min(b.texture[axis]).min(c.texture[axis]);
        let most = |axis: usize| a.texture[axis].max(b.texture[axis]).max(c.texture[axis]);
        let (low, high) = ([least(0), least(1)], [most(0), most(1)]);
        let range = self.map.range(low, high, margin);
        let (one, other) = (self.height * range.values[0] + self.offset, self.height * range.values[1] + self.offset);
        let mut heights = [one.min(other), one.max(other)];
        if range.may_be_nothing {
            heights = [heights[0].min(0.0), heights[1].max(0.0)];
        }
        let factors = [a.factor.min(b.factor).min(c.factor), a.factor.max(b.factor).max(c.factor)];
        let always_off = match range.may_be_nothing {
            // Beyond the map there may be a step of any height but none.
            true if heights == [0.0; 2] => 0.0,
            true => f64::INFINITY,
            false => range.step * self.height.abs(),
        };
        Span {
            always_off,
            texel_bend: range.bend * self.height.abs(),
            texels: self.map.texels_between(low, high),
            heights,
            factors,
            lengths: products(heights, factors),
            squared_chord: squared_chord([a, b, c].map(|point| point.direction)),
        }
    }

    /// Bounds of the displacement between three points, between which is `span`.
    fn bounds(&self, points: [&Point; 3], span: &Span) -> (DVec3, DVec3) {
        let framed = points.map(|point| self.frame * point.direction);
        let [low, high] = directions(framed, span.squared_chord, self.reach);
        let [x, y, z] = [
            products(span.lengths, [low.x, high.x]),
            products(span.lengths, [low.y, high.y]),
            products(span.lengths, [low.z, high.z]),
        ];
        (DVec3::new(x[0], y[0], z[0]), DVec3::new(x[1], y[1], z[1]))
    }

    /// Adds how far the displacement may be from linear. The product of two functions is as far from linear as each of them, and a quarter of
    /// the product of their changes.
    fn add_off(&self, off: &mut Off, span: &Span) {
        let Span { heights, factors, lengths, squared_chord, .. } = span;
        let largest_factor = factors[0].abs().max(factors[1].abs());
        if largest_factor == 0.0 || self.reach == DVec3::ZERO {
            return;
        }
        let reach = self.reach.length();
        let factor_off = (factors[1] - factors[0]) * (heights[1] - heights[0]) / 4.0;
        let longest = lengths[0].abs().max(lengths[1].abs());
        off.always += span.always_off * largest_factor * reach;
        off.linear += (factor_off + (lengths[1] - lengths[0]) * squared_chord.sqrt() / 4.0) * reach;
        off.squared += longest * squared_chord / 8.0 * reach;
        (off.texel_bend, off.texels) = (span.texel_bend * largest_factor * reach, span.texels);
    }
}

/// The range of the products of two numbers in these ranges.
fn products([a, b]: [f64; 2], [c, d]: [f64; 2]) -> [f64; 2] {
    let all = [a * c, a * d, b * c, b * d];
    [all[0].min(all[1]).min(all[2].min(all[3])), all[0].max(all[1]).max(all[2].max(all[3]))]
}
