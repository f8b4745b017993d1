//! Thin parts of a region: where they are, told by local width, and along which line they are marked. `layer_plan` uses it.
//!
//! A disc as wide as the limit is rolled through the region. What it cannot reach is thin, whether it is an island of its own, a web
//! between two wide parts or a spike. The wide rest gets contours.
//!
//! Corners are not thin parts: the disc does not reach into them, but contours do. So a piece that it leaves out counts only if it is
//! longer than a beam, or joins two wide parts.

use std::borrow::Cow;

use i_overlay::core::edge_data::{EdgeDataMerge, OverlayEdgeData};
use i_overlay::core::edge_overlay::{EdgeOverlay, InputEdge};
use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay::ShapeType;
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::segm::boolean::ShapeCountBoolean;
use i_overlay::vector::edge::DataVectorEdge;

use super::bare::bare_stretches;
use super::middle::{Joint, middle_lines};
use super::offset::{Area, Point, to_um};
use super::path::{distance_um, length_um, ring_edges, simplify};

/// By how much farther than its radius the disc reaches. It keeps rounding and the polygons of arcs from leaving slivers along borders.
pub(super) const REACH: f64 = 1.1;

/// What a region consists of.
#[derive(Debug, Default)]
pub(super) struct Split {
    /// What is at least as wide as the limit, with its corners.
    pub(super) wide: Wide,
    /// What is narrower.
    pub(super) thin: Vec<ThinPart>,
}

/// The wide part of a region.
#[derive(Debug, Default)]
pub(super) struct Wide {
    pub(super) area: Area,
    /// Its inset by a distance, micrometres, if that was found on the way. With usual settings the ends of hatches lie on it.
    inset: Option<(f64, Area)>,
}

impl Wide {
    /// The area moved inwards by a distance, micrometres.
    pub(super) fn inset(&self, distance_um: f64) -> Cow<'_, Area> {
        match &self.inset {
            Some((known_um, inset)) if *known_um == distance_um => Cow::Borrowed(inset),
            _ => Cow::Owned(self.area.offset(-distance_um)),
        }
    }

    /// As [`Wide::inset`], but arcs may leave their circles by twice the usual error. It may take less time.
    pub(super) fn rough_inset(&self, distance_um: f64) -> Cow<'_, Area> {
        match &self.inset {
            Some((known_um, inset)) if *known_um < distance_um => Cow::Owned(inset.offset(known_um - distance_um)),
            _ => self.inset(distance_um),
        }
    }
}

/// A connected part narrower than the limit.
#[derive(Debug)]
pub(super) struct ThinPart {
    /// One shape.
    pub(super) area: Area,
    /// Where it meets wide parts.
    pub(super) joints: Vec<Joint>,
}

/// What a thin part is marked with.
#[derive(Debug, PartialEq)]
pub(super) enum ThinMark {
    /// Lines, micrometres. A closed one repeats its first point.
    Lines(Vec<Vec<[f64; 2]>>),
    /// A point, micrometres.
    Point([f64; 2]),
}

/// What limits the lines of thin parts. All lengths are micrometres.
#[derive(Clone, Copy, Debug)]
pub(super) struct ThinRules {
    /// Local width below which a part is thin.
    pub(super) below_um: f64,
    /// Width of the melted track.
    pub(super) beam_um: f64,
    /// How far inside a wide part its outermost contour lies. Lines reach it.
    pub(super) contour_um: f64,
    /// Shorter lines become points.
    pub(super) point_below_um: f64,
    /// Most by which a line leaves the middle when points are left out.
    pub(super) tolerance_um: f64,
}

/// Splits an area by local width.
pub(super) fn split(area: Area, rules: &ThinRules) -> Split {
    if rules.below_um <= 0.0 {
        return Split { wide: Wide { area, inset: None }, thin: Vec::new() };
    }
    let radius_um = rules.below_um / 2.0;
    let core = area.offset(-radius_um);
    if core.is_empty() {
        let thin = area.into_pieces().map(|area| ThinPart { area, joints: Vec::new() });
        return Split { wide: Wide::default(), thin: thin.collect() };
    }
    let reach_um = radius_um * REACH;
    if has_corners_only(&area, &core, reach_um, rules) {
        return Split { wide: Wide { area, inset: Some((radius_um, core)) }, thin: Vec::new() };
    }
    let thin = thin_parts(&area, &core, reach_um, rules);
    let wide = area.subtract(&Area::from_shapes(thin.iter().flat_map(|part| part.area.shapes()).cloned().collect()));
    Split { wide: Wide { area: wide, inset: None }, thin }
}

/// The pieces that the disc leaves out and that are not corners.
fn thin_parts(area: &Area, core: &Area, reach_um: f64, rules: &ThinRules) -> Vec<ThinPart> {
    let reached = core.offset(reach_um);
    left_out(area, &reached).into_iter().filter_map(|shape| thin_part(&shape, rules)).collect()
}

/// Whether no piece that the disc leaves out is a thin part, told by the border alone. `core` is where the disc's centre goes.
///
/// If the core has one shape with as many holes as the area, it goes around each hole, so no piece joins two wide parts: each is cut off
/// once, and has one stretch of the border. It is a corner if that reaches less than a beam.
fn has_corners_only(area: &Area, core: &Area, reach_um: f64, rules: &ThinRules) -> bool {
    let is_alike = area.shapes().len() == 1 && core.shapes().len() == 1 && area.rings().count() == core.rings().count();
    is_alike
        && bare_stretches(area, core, reach_um)
            .iter()
            .all(|stretch| !stretch.is_ring && stretch.reach_um() < rules.beam_um)
}

/// What a thin part is marked with: lines along its middle, or a point if they are short. Never nothing.
pub(super) fn thin_mark(part: &ThinPart, rules: &ThinRules) -> ThinMark {
    let mut lines = middle_lines(&part.area, &part.joints, rules);
    if lines.iter().any(|line| extent_um(line) >= rules.point_below_um) {
        lines.iter_mut().for_each(|line| simplify(line, rules.tolerance_um));
        return ThinMark::Lines(lines);
    }
    let longest = lines.iter().max_by(|a, b| length_um(a).total_cmp(&length_um(b)));
    ThinMark::Point(longest.filter(|line| line.len() > 1).map_or_else(|| centre_um(&part.area), |line| halfway(line)))
}

/// Whose border an edge of a piece comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Side {
    Region,
    Reached,
}

impl OverlayEdgeData for Side {
    type Store = ();

    fn merge(context: EdgeDataMerge<ShapeCountBoolean, Self>, (): &mut ()) -> Self {
        // Where both borders lie on each other, the region ends.
        if context.lhs_data == context.rhs_data { context.lhs_data } else { Self::Region }
    }
}

type Edges = Vec<DataVectorEdge<i32, Side>>;

/// The pieces of an area outside another, with the origin of each edge.
fn left_out(area: &Area, reached: &Area) -> Vec<Vec<Edges>> {
    let mut overlay = EdgeOverlay::new(0);
    for (of, data, kind) in [(area, Side::Region, ShapeType::Subject), (reached, Side::Reached, ShapeType::Clip)] {
        for ring in of.rings() {
            overlay.add_edges(ring_edges(ring).map(|[a, b]| InputEdge { a, b, data }), kind);
        }
    }
    overlay.build_vector_shapes(OverlayRule::Difference, FillRule::NonZero)
}

/// A piece, if it is a thin part and not a corner.
fn thin_part(shape: &[Edges], rules: &ThinRules) -> Option<ThinPart> {
    let cuts: Vec<[Point; 2]> = shape.iter().flat_map(|ring| cut_ends(ring)).collect();
    let of_region = || shape.iter().flatten().filter(|edge| edge.data == Side::Region);
    let points = || of_region().flat_map(|edge| [edge.a, edge.b]).map(to_um);
    // How far it reaches from where it was cut off.
    let reach_um = |cut: &[Point; 2]| {
        let ends = cut.map(to_um);
        points().map(|point| ends.map(|end| distance_um(point, end))).fold(0.0, |most: f64, [a, b]| most.max(a.min(b)))
    };
    let least_um = if cuts.len() > 1 { rules.beam_um / 4.0 } else { rules.beam_um };
    if cuts.iter().any(|cut| reach_um(cut) < least_um) {
        return None;
    }
    let joints = cuts.iter().filter_map(joint).collect();
    let rings = shape.iter().map(|ring| ring.iter().map(|edge| edge.a).collect());
    Some(ThinPart { area: Area::from_shapes(vec![rings.collect()]), joints })
}

/// First and last point of each stretch of a ring that was cut off from the wide part.
fn cut_ends(ring: &[DataVectorEdge<i32, Side>]) -> Vec<[Point; 2]> {
    // Begins behind an edge of the region, so that no stretch runs over the end of the list.
    let Some(start) = ring.iter().position(|edge| edge.data == Side::Region) else { return Vec::new() };
    let mut ends: Vec<[Point; 2]> = Vec::new();
    let mut is_cut = false;
    for number in 1..ring.len() {
        let edge = &ring[(start + number) % ring.len()];
        let was_cut = std::mem::replace(&mut is_cut, edge.data == Side::Reached);
        match ends.last_mut().filter(|_| was_cut) {
            Some(end) if is_cut => end[1] = edge.b,
            _ if is_cut => ends.push([edge.a, edge.b]),
            _ => {}
        }
    }
    ends
}

/// The joint at a cut. The part lies to the left of the cut, the wide part to the right.
fn joint(cut: &[Point; 2]) -> Option<Joint> {
    let [a, b] = cut.map(to_um);
    let width_um = distance_um(a, b);
    let outwards = [(b[1] - a[1]) / width_um, (a[0] - b[0]) / width_um];
    (width_um > 0.0).then(|| Joint { at_um: [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0], outwards, width_um })
}

/// How far a line reaches: the diagonal of its bounds. In a compact area a line may be longer than that, as it winds.
fn extent_um(line: &[[f64; 2]]) -> f64 {
    let bounds =
        |axis: usize, pick: fn(f64, f64) -> f64, from: f64| line.iter().map(|point| point[axis]).fold(from, pick);
    let [x, y] = [0, 1].map(|axis| bounds(axis, f64::max, f64::MIN) - bounds(axis, f64::min, f64::MAX));
    x.hypot(y)
}

/// Centre of gravity of an area's first outer ring.
fn centre_um(area: &Area) -> [f64; 2] {
    let Some(ring) = area.rings().next() else { return [0.0; 2] };
    let origin = ring.first().map_or([0.0; 2], |point| to_um(*point));
    let from_origin = |point: &Point| {
        let point = to_um(*point);
        [point[0] - origin[0], point[1] - origin[1]]
    };
    let (mut doubled, mut sum) = (0.0, [0.0; 2]);
    for pair in ring.windows(2) {
        let [a, b] = [from_origin(&pair[0]), from_origin(&pair[1])];
        let cross = a[0] * b[1] - a[1] * b[0];
        doubled += cross;
        sum = [0, 1].map(|axis| sum[axis] + cross * (a[axis] + b[axis]) / 3.0);
    }
    let share = if doubled > 0.0 { 1.0 / doubled } else { 0.0 };
    [0, 1].map(|axis| origin[axis] + sum[axis] * share)
}

/// The point half the way along a line.
fn halfway(line: &[[f64; 2]]) -> [f64; 2] {
    let mut rest_um = length_um(line) / 2.0;
    for pair in line.windows(2) {
        let step_um = distance_um(pair[0], pair[1]);
        if rest_um <= step_um && step_um > 0.0 {
            return [0, 1].map(|axis| pair[0][axis] + (pair[1][axis] - pair[0][axis]) * rest_um / step_um);
        }
        rest_um -= step_um;
    }
    line[line.len() - 1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slice::scan::Region;
    use std::f64::consts::TAU;

    #[test]
    fn the_border_alone_never_hides_a_thin_part() {
        let rules =
            ThinRules { below_um: 120.0, beam_um: 60.0, contour_um: 30.0, point_below_um: 60.0, tolerance_um: 5.0 };
        let reach_um = 66.0;
        let (mut decided, mut thin) = (0, 0);
        // Plates with two waists, each from wide to none, a spike, and a hole that leaves a web beside it.
        for number in 0..400 {
            let share = |factor: u32| f64::from(number * factor % 101) / 100.0;
            let point = |step: u32| {
                let angle = TAU * f64::from(step) / 90.0;
                let waist = 1.0 - share(7) * (2.0 * angle).cos().max(0.0).powi(4) * 0.95;
                let spike = if number % 4 == 0 && step == number % 90 { 1.0 + share(13) } else { 1.0 };
                let radius = 500.0 * waist * spike;
                [2000.0 + radius * angle.sin(), 2000.0 + radius * angle.cos()]
            };
            let hole = (0..30).rev().map(|step| {
                let angle = TAU * f64::from(step) / 30.0;
                [1700.0 + 60.0 * angle.cos(), 2000.0 + 300.0 * share(29) + 60.0 * angle.sin()]
            });
            let is_wide = share(7) < 0.3 && number % 2 == 0;
            let outer = (0..90).rev().map(point).collect();
            let area = Area::of(&Region { outer, holes: if is_wide { vec![hole.collect()] } else { Vec::new() } });
            let core = area.offset(-60.0);
            let parts = thin_parts(&area, &core, reach_um, &rules);
            thin += u32::from(!parts.is_empty());
            if has_corners_only(&area, &core, reach_um, &rules) {
                decided += 1;
                assert!(parts.is_empty(), "{number}: {parts:?}");
            }
        }
        assert!(decided > 100 && thin > 50, "{decided} decided, {thin} with thin parts");
    }
}
