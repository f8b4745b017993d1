//! Areas in whole nanometres: inset, outset and difference. `thin`, `layer_plan` and `skin` use them.
//!
//! Areas are combined by `i_overlay` on whole numbers; offsets are made by `convex` and `trim`, and by the library where neither can.
//! The same input gives the same result on every machine. One nanometre is far below what a scanner resolves, and 32 bits hold a field of
//! [`MAX_FIELD_UM`].

use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay::{IntOverlayOptions, Overlay, ShapeType};
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::core::solver::Solver;
use i_overlay::i_float::int::angle::Angle;
use i_overlay::i_float::int::point::IntPoint;
use i_overlay::i_shape::int::shape::IntShape;
use i_overlay::mesh::int::arc::ArcOptions;
use i_overlay::mesh::int::outline::offset::IntOutlineOffset;
use i_overlay::mesh::int::style::{IntLineJoin, IntOutlineStyle};
use i_overlay::mesh::math::MathMode;

use super::convex::{inset, is_convex, outset};
use super::region::Region;
use super::trim;

/// Largest coordinate of a field, micrometres: the library computes with whole numbers below 2³⁰, here nanometres, and offsets need some
/// of that.
pub const MAX_FIELD_UM: f64 = 1_000_000.0;

/// Most by which an arc leaves its circle, micrometres. Arcs are where an offset goes around a corner.
pub(super) const ARC_ERROR_UM: f64 = 0.5;

/// Longest offset by the library, micrometres. Moved by less than the distance from one corner to the next, edges cross few others; the
/// crossings of a rough border of many corners, moved far, once took a hundred times the memory of the border.
const LIBRARY_STEP_UM: f64 = 10.0;

/// Share of the first of two steps. With unlike steps, what touches after the whole distance seldom touches after a part of it.
const FIRST_STEP: f64 = 0.6;

/// Pieces with a smaller area are rounding errors, square nanometres: a thousandth of a square micrometre.
pub(super) const LEAST_AREA_NM2: u64 = 1000;

/// A point in whole nanometres.
pub(super) type Point = IntPoint<i32>;
/// A closed ring; the first point is not repeated.
pub(super) type Contour = Vec<Point>;
/// Low and high corner of a box.
pub(super) type Corners = [Point; 2];

/// Any number of shapes. Each is an outer ring, counter-clockwise, then its holes, clockwise. Shapes do not overlap.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Area {
    shapes: Vec<IntShape<i32>>,
}

impl Area {
    /// The area of a region. Rings with less than three points are left out.
    pub(super) fn of(region: &Region) -> Self {
        let shape: IntShape<i32> =
            region.rings().map(|ring| ring.iter().map(|point| to_nm(*point)).collect()).collect();
        let empty = shape.first().is_none_or(|outer| outer.len() < 3);
        Self { shapes: if empty { Vec::new() } else { vec![shape] } }
    }

    /// From shapes of the kind that [`Area`] holds.
    pub(super) fn from_shapes(shapes: Vec<IntShape<i32>>) -> Self {
        Self { shapes }
    }

    /// The shapes.
    pub(super) fn shapes(&self) -> &[IntShape<i32>] {
        &self.shapes
    }

    /// Each shape as an area of its own.
    pub(super) fn into_pieces(self) -> impl Iterator<Item = Self> {
        self.shapes.into_iter().map(|shape| Self { shapes: vec![shape] })
    }

    /// All rings.
    pub(super) fn rings(&self) -> impl Iterator<Item = &Contour> {
        self.shapes.iter().flatten()
    }

    /// Whether there is nothing.
    pub(super) fn is_empty(&self) -> bool {
        self.shapes.is_empty()
    }

    /// Area, square micrometres.
    pub(super) fn area_um2(&self) -> f64 {
        self.rings().map(|ring| doubled_area_nm2(ring) as f64).sum::<f64>() / 2e6
    }

    /// The points within a distance of the area, or, for a negative distance, those farther than that from its border. Corners are
    /// rounded, so no spikes appear. What gets too narrow vanishes, and a shape may fall apart.
    pub(super) fn offset(&self, distance_um: f64) -> Self {
        self.offset_within(distance_um, ARC_ERROR_UM)
    }

    /// As [`Area::offset`]. Arcs leave their circles by at most `error_um`.
    fn offset_within(&self, distance_um: f64, error_um: f64) -> Self {
        let radius_um = distance_um.abs();
        if self.is_empty() || radius_um < 5e-4 {
            return self.clone();
        }
        if distance_um < 0.0 && !self.shapes.iter().any(|shape| may_hold_disc(shape, radius_um * 1000.0)) {
            return Self::default();
        }
        if let Some(ring) = self.convex_ring() {
            let nm = radius_um * 1000.0;
            let ring = if distance_um < 0.0 { inset(ring, nm) } else { outset(ring, nm, error_um * 1000.0) };
            let is_left = doubled_area_nm2(&ring) > 2 * LEAST_AREA_NM2 as i64;
            return Self { shapes: if is_left { vec![vec![ring]] } else { Vec::new() } };
        }
        if let Some(shapes) = trim::offset(self, distance_um * 1000.0, error_um * 1000.0) {
            return Self { shapes };
        }
        if radius_um <= LIBRARY_STEP_UM {
            return self.library_offset(distance_um, error_um);
        }
        // In two steps nothing may touch. They add their errors.
        let [first_um, second_um] = [FIRST_STEP, 1.0 - FIRST_STEP].map(|share| distance_um * share);
        self.offset_within(first_um, error_um / 2.0).offset_within(second_um, error_um / 2.0)
    }

    /// As [`Area::offset_within`], by the library. It takes memory for each crossing of moved edges: for small distances only.
    pub(super) fn library_offset(&self, distance_um: f64, error_um: f64) -> Self {
        let radius_um = distance_um.abs();
        let step = 2.0 * (1.0 - error_um / radius_um).clamp(-1.0, 1.0).acos();
        let arc = ArcOptions { max_step: angle(step), ..ArcOptions::default() };
        let style = IntOutlineStyle::new((distance_um * 1000.0).round() as i32)
            .line_join(IntLineJoin::Round(arc))
            .math(MathMode::Integer);
        // It has no way to fail, although its type says so.
        let shapes = self.shapes.outline_custom(&style, options()).unwrap_or_default();
        Self { shapes }
    }

    /// The ring of an area that is one convex shape without holes.
    fn convex_ring(&self) -> Option<&Contour> {
        let [shape] = &self.shapes[..] else { return None };
        let [ring] = &shape[..] else { return None };
        is_convex(ring).then_some(ring)
    }

    /// What lies in both areas.
    #[cfg(test)]
    pub(super) fn intersect(&self, other: &Self) -> Self {
        if self.is_empty() || other.is_empty() {
            return Self::default();
        }
        self.combine(other, OverlayRule::Intersect)
    }

    /// What lies in this area, but not in the other.
    pub(super) fn subtract(&self, other: &Self) -> Self {
        if self.is_empty() || other.is_empty() {
            return self.clone();
        }
        self.combine(other, OverlayRule::Difference)
    }

    fn combine(&self, other: &Self, rule: OverlayRule) -> Self {
        let mut overlay = Overlay::new_custom(0, options(), Solver::default());
        overlay.add_source(&self.shapes, ShapeType::Subject);
        overlay.add_source(&other.shapes, ShapeType::Clip);
        Self { shapes: overlay.overlay(rule, FillRule::NonZero) }
    }

    /// Low and high corner; `None` if there is nothing.
    pub(super) fn bounds_nm(&self) -> Option<Corners> {
        let points = self.shapes.iter().filter_map(|shape| shape.first()).flatten();
        points.map(|point| [*point; 2]).reduce(around)
    }
}

/// Whether a shape is wide enough for a disc in four directions: along x and y, and halfway between them.
fn may_hold_disc(shape: &IntShape<i32>, radius_nm: f64) -> bool {
    let Some(outer) = shape.first() else { return false };
    let directions = |point: &Point| {
        let [x, y] = [point.x, point.y].map(i64::from);
        [x, y, x + y, x - y]
    };
    let (mut low, mut high) = ([i64::MAX; 4], [i64::MIN; 4]);
    for along in outer.iter().map(directions) {
        low = std::array::from_fn(|number| low[number].min(along[number]));
        high = std::array::from_fn(|number| high[number].max(along[number]));
    }
    let width_nm = |number: usize| (high[number] - low[number]) as f64;
    let diagonal = std::f64::consts::SQRT_2;
    (0..2).all(|straight| width_nm(straight) >= 2.0 * radius_nm)
        && (2..4).all(|slanted| width_nm(slanted) >= 2.0 * radius_nm * diagonal)
}

fn options() -> IntOverlayOptions<u64> {
    IntOverlayOptions { min_output_area: LEAST_AREA_NM2, ..IntOverlayOptions::default() }
}

fn angle(radians: f64) -> Angle {
    Angle::from_radians(radians).unwrap_or(ArcOptions::MAX_STEP)
}

/// The box around two boxes.
pub(super) fn around([low, high]: Corners, [other_low, other_high]: Corners) -> Corners {
    [
        Point::new(low.x.min(other_low.x), low.y.min(other_low.y)),
        Point::new(high.x.max(other_high.x), high.y.max(other_high.y)),
    ]
}

/// A point in nanometres, from micrometres. Points outside the largest field are moved to its edge; `fill` refuses them before.
pub(super) fn to_nm(point_um: [f64; 2]) -> Point {
    let [x, y] = point_um.map(|um| (um.clamp(-MAX_FIELD_UM, MAX_FIELD_UM) * 1000.0).round() as i32);
    Point::new(x, y)
}

/// A point in micrometres.
pub(super) fn to_um(point: Point) -> [f64; 2] {
    [point.x, point.y].map(|nm| f64::from(nm) / 1000.0)
}

/// Twice the area inside a ring; positive if it runs counter-clockwise.
pub(super) fn doubled_area_nm2(ring: &[Point]) -> i64 {
    let Some(first) = ring.first() else { return 0 };
    ring.windows(2).map(|pair| doubled_triangle_nm2(*first, pair[0], pair[1])).sum()
}

/// Twice the area of a triangle; positive if it runs counter-clockwise.
pub(super) fn doubled_triangle_nm2(a: Point, b: Point, c: Point) -> i64 {
    let [bx, by] = [i64::from(b.x) - i64::from(a.x), i64::from(b.y) - i64::from(a.y)];
    let [cx, cy] = [i64::from(c.x) - i64::from(a.x), i64::from(c.y) - i64::from(a.y)];
    bx * cy - by * cx
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    fn disc(at: f64, radius_um: f64, points: u32) -> Vec<[f64; 2]> {
        let angles = (0..points).map(|number| TAU * f64::from(number) / f64::from(points));
        angles.map(|angle| [at + radius_um * angle.cos(), at + radius_um * angle.sin()]).collect()
    }

    fn rectangle(low: [f64; 2], high: [f64; 2]) -> Area {
        Area::of(&Region { outer: vec![low, [high[0], low[1]], high, [low[0], high[1]]], holes: Vec::new() })
    }

    fn close(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() <= tolerance * expected.abs(), "{found} instead of {expected}");
    }

    #[test]
    fn a_disc_keeps_its_shape_at_the_far_end_of_a_field() {
        for at in [600.0, 400_000.0, 999_000.0] {
            let area = Area::of(&Region { outer: disc(at, 500.0, 180), holes: Vec::new() });
            for distance_um in [-30.0, -120.0, 45.0, 200.0] {
                close(area.offset(distance_um).area_um2(), PI * (500.0_f64 + distance_um).powi(2), 0.004);
            }
            assert!(area.offset(-501.0).is_empty(), "it collapses");
        }
    }

    #[test]
    fn an_offset_is_exact_along_straight_borders() {
        let area = rectangle([399_000.0, 10.0], [400_000.0, 510.0]);
        let bounds = |distance_um| area.offset(distance_um).bounds_nm().map(|corners| corners.map(to_um));
        assert_eq!(bounds(-30.0), Some([[399_030.0, 40.0], [399_970.0, 480.0]]));
        assert_eq!(bounds(30.0), Some([[398_970.0, -20.0], [400_030.0, 540.0]]));
    }

    #[test]
    fn a_hole_grows_where_the_area_shrinks() {
        let mut hole = disc(1000.0, 200.0, 180);
        hole.reverse();
        let ring = Area::of(&Region { outer: disc(1000.0, 500.0, 180), holes: vec![hole] });
        close(ring.offset(-50.0).area_um2(), PI * (450.0_f64.powi(2) - 250.0_f64.powi(2)), 0.01);
        assert!(ring.offset(-151.0).is_empty());
    }

    #[test]
    fn areas_are_combined() {
        let (a, b) = (rectangle([0.0, 0.0], [100.0, 100.0]), rectangle([50.0, 50.0], [150.0, 150.0]));
        close(a.intersect(&b).area_um2(), 2500.0, 1e-9);
        close(a.subtract(&b).area_um2(), 7500.0, 1e-9);
        assert_eq!(a.intersect(&Area::default()), Area::default());
        assert_eq!(a.subtract(&Area::default()), a);
    }
}
