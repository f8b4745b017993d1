//! Offsets of any rings, by trimming. `offset` uses it: it takes about a tenth of the time of the library's way.
//!
//! Each edge is moved to the side by the distance, and where the border turns away, an arc goes around the corner. The parts of these lines
//! and arcs that lie nearer to another edge than the distance are cut off. The rest is the border of the offset area, in pieces, which
//! `stitch` puts together.

use super::border::{
    Border, Bounds, CircleCut, Edge, Spans, Vector, along, circle_in_capsule, cross, dot, line_in_capsule,
};
use super::offset::{Area, Contour};
use super::stitch::{Arc, NONE, Piece, Pieces, Stitcher};

/// The area offset inwards (negative distance) or outwards, nanometres. `None` if trimming cannot tell.
pub(super) fn offset(area: &Area, distance_nm: f64, error_nm: f64) -> Option<Vec<Vec<Contour>>> {
    let origin = *area.rings().next()?.first()?;
    let border = Border::of(area, origin);
    let trimmer =
        Trimmer { side: if distance_nm < 0.0 { 1.0 } else { -1.0 }, radius: distance_nm.abs(), border: &border };
    Stitcher { radius: trimmer.radius, side: trimmer.side, error: error_nm, origin }.shapes(trimmer.pieces()?)
}

/// How many neighbouring edges are trimmed with one search for what is near them.
const GROUP_EDGES: usize = 4;

struct Trimmer<'a> {
    border: &'a Border,
    radius: f64,
    /// 1 if the offset lies to the left of the edges, -1 if to the right.
    side: f64,
}

impl Trimmer<'_> {
    fn normal(&self, edge: &Edge) -> Vector {
        [-edge.along[1] * self.side, edge.along[0] * self.side]
    }

    /// Whether the border turns towards the side of the offset behind an edge.
    fn turns_in(&self, edge: &Edge) -> bool {
        let next = &self.border.edges[edge.next as usize];
        cross(edge.along, next.along) * self.side > 0.0
    }

    fn pieces(&self) -> Option<Pieces> {
        let edges = &self.border.edges;
        let mut before = vec![NONE; edges.len()];
        for (number, edge) in edges.iter().enumerate() {
            before[edge.next as usize] = number as u32;
        }
        let arc_count = edges.iter().filter(|edge| !self.turns_in(edge)).count();
        // More are needed only where other edges cut lines in two.
        let (pieces, arcs) = (Vec::with_capacity(edges.len() + arc_count), Vec::with_capacity(arc_count));
        let mut found = Pieces { pieces, arcs };
        let mut spans = Spans::default();
        let mut near = Vec::new();
        for first in (0..edges.len()).step_by(GROUP_EDGES) {
            let group = first..edges.len().min(first + GROUP_EDGES);
            near.clear();
            let bounds = edges[group.clone()].iter().map(|edge| self.moved_bounds(edge)).reduce(Bounds::with)?;
            self.border.near(bounds.grown(self.radius), &mut |other| {
                near.push((edges[other as usize].bounds, other));
                true
            });
            for number in group {
                self.trim_line(number as u32, before[number], &near, &mut spans);
                self.add_line(number as u32, &spans, &mut found.pieces);
                if !self.turns_in(&edges[number]) {
                    self.trim_arc(number as u32, &near, &mut spans)?;
                    self.add_arc(number as u32, &spans, &mut found);
                }
            }
        }
        Some(found)
    }

    /// Box of the line and the arc of an edge.
    fn moved_bounds(&self, edge: &Edge) -> Bounds {
        let from = along(edge.from, self.normal(edge), self.radius);
        let line = Bounds::of(from, along(from, edge.along, edge.length));
        if self.turns_in(edge) { line } else { line.with(self.arc_bounds(edge)) }
    }

    fn arc_bounds(&self, edge: &Edge) -> Bounds {
        let [begin, end] = self.arc_ends(edge);
        let centre = edge.end();
        let ends = [begin, end].map(|end| along(centre, end, self.radius));
        // The middle of the arc is this much farther out than its ends.
        let rise = self.radius * (1.0 - ((1.0 + dot(begin, end)) / 2.0).max(0.0).sqrt());
        Bounds::of(ends[0], ends[1]).grown(rise)
    }

    /// What is left of an edge that was moved. `before` is the edge before it, `near` has what may cut it.
    fn trim_line(&self, number: u32, before: u32, near: &[(Bounds, u32)], spans: &mut Spans) {
        let edges = &self.border.edges;
        let edge = &edges[number as usize];
        let from = along(edge.from, self.normal(edge), self.radius);
        spans.begin([0.0, edge.length]);
        let mut cut = |other: u32| {
            let stretch = line_in_capsule(from, edge.along, edge.length, &edges[other as usize], self.radius);
            stretch.is_none_or(|stretch| spans.remove(stretch))
        };
        // A neighbour that turns in cuts most, often all. One that turns away only touches.
        let is_left =
            (!self.turns_in(edge) || cut(edge.next)) && (!self.turns_in(&edges[before as usize]) || cut(before));
        let bounds = Bounds::of(from, along(from, edge.along, edge.length)).grown(self.radius).reach();
        let mut others = near.iter().filter(|(other, _)| other.meets(&bounds)).map(|(_, other)| *other);
        let is_known = |other| other == number || other == edge.next || other == before;
        let _ = is_left && others.all(|other| is_known(other) || cut(other));
    }

    fn add_line(&self, number: u32, spans: &Spans, pieces: &mut Vec<Piece>) {
        let edge = &self.border.edges[number as usize];
        let from = along(edge.from, self.normal(edge), self.radius);
        let after = if self.turns_in(edge) { 2 * edge.next } else { 2 * number + 1 };
        pieces.extend(spans.left.iter().map(|[low, high]| Piece {
            from: along(from, edge.along, *low),
            to: along(from, edge.along, *high),
            arc: NONE,
            is_whole: [*low == 0.0, *high == edge.length],
            place: 2 * number,
            after,
            next: NONE,
        }));
    }

    /// Both ends of the arc around the end of an edge, as unit vectors.
    fn arc_ends(&self, edge: &Edge) -> [Vector; 2] {
        [edge, &self.border.edges[edge.next as usize]].map(|edge| self.normal(edge))
    }

    /// How far a unit vector is turned from another, the way the arcs go: from 0 to 4, for a whole turn. It grows with the angle.
    fn turn(&self, from: Vector, to: Vector) -> f64 {
        let (c, s) = (dot(from, to), -self.side * cross(from, to));
        match (s >= 0.0, c >= 0.0) {
            (true, true) => s / (c + s),
            (true, false) => 1.0 - c / (s - c),
            (false, false) => 2.0 + s / (s + c),
            (false, true) => 3.0 + c / (c - s),
        }
    }

    /// What is left of the arc around the end of an edge. `None` if rounding hides it.
    fn trim_arc(&self, number: u32, near: &[(Bounds, u32)], spans: &mut Spans) -> Option<()> {
        let edge = &self.border.edges[number as usize];
        let [begin, end] = self.arc_ends(edge);
        let centre = edge.end();
        spans.begin([0.0, self.turn(begin, end).min(2.0)]);
        let bounds = self.arc_bounds(edge).grown(self.radius).reach();
        let others = near.iter().filter(|(other, _)| other.meets(&bounds)).map(|(_, other)| *other);
        for other in others.filter(|other| *other != number && *other != edge.next) {
            let cutter = &self.border.edges[other as usize];
            let is_left = match circle_in_capsule(centre, cutter, self.radius) {
                CircleCut::None => true,
                CircleCut::Unknown => return None,
                CircleCut::Some { ends, middle } => {
                    let [a, b] = ends.map(|end| self.turn(begin, end));
                    let (low, high) = (a.min(b), a.max(b));
                    if (low..=high).contains(&self.turn(begin, middle)) {
                        spans.remove([low, high])
                    } else {
                        spans.remove([-1.0, low]) && spans.remove([high, 5.0])
                    }
                }
            };
            if !is_left {
                break;
            }
        }
        Some(())
    }

    fn add_arc(&self, number: u32, spans: &Spans, found: &mut Pieces) {
        let edge = &self.border.edges[number as usize];
        let [begin, end] = self.arc_ends(edge);
        let whole = self.turn(begin, end).min(2.0);
        let centre = edge.end();
        for [low, high] in &spans.left {
            let ends = [*low, *high].map(|turn| if turn == whole { end } else { self.turned(begin, turn) });
            found.pieces.push(Piece {
                from: along(centre, ends[0], self.radius),
                to: along(centre, ends[1], self.radius),
                arc: found.arcs.len() as u32,
                is_whole: [*low == 0.0, *high == whole],
                place: 2 * number + 1,
                after: 2 * edge.next,
                next: NONE,
            });
            found.arcs.push(Arc { centre, ends });
        }
    }

    /// The unit vector at a turn from another; see [`Trimmer::turn`].
    fn turned(&self, from: Vector, turn: f64) -> Vector {
        let part = turn.fract();
        // On a square that stands on a corner, then on the circle.
        let (c, s) = match turn as u32 {
            0 => (1.0 - part, part),
            1 => (-part, 1.0 - part),
            2 => (part - 1.0, -part),
            _ => (part, part - 1.0),
        };
        let length = (c * c + s * s).sqrt();
        let (c, s) = (c / length, -self.side * s / length);
        [from[0] * c - from[1] * s, from[0] * s + from[1] * c]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slice::scan::Region;
    use crate::slice::scan::offset::{Point, doubled_area_nm2};
    use std::f64::consts::TAU;

    const ERROR_UM: f64 = 0.5;

    /// The generator of Knuth's MMIX; its high bits.
    struct Random(u64);

    impl Random {
        fn from(&mut self, low: f64, high: f64) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            low + (high - low) * ((self.0 >> 33) as f64 / (1u64 << 31) as f64)
        }
    }

    /// A star of random radii around a point.
    fn star(random: &mut Random, centre: [f64; 2], radii_um: [f64; 2]) -> Vec<[f64; 2]> {
        let count = random.from(4.0, 60.0) as u32;
        let angles = (0..count).map(|number| TAU * f64::from(number) / f64::from(count));
        let point = |angle: f64| {
            let radius = random.from(radii_um[0], radii_um[1]);
            [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
        };
        angles.map(point).collect()
    }

    /// A star with up to three holes, which may lie close to each other and to the border.
    fn region(random: &mut Random) -> Region {
        let centre = [random.from(2000.0, 900_000.0), random.from(2000.0, 900_000.0)];
        let outer = star(random, centre, [450.0, 900.0]);
        let holes = (0..random.from(0.0, 4.0) as u32).map(|number| {
            let angle = TAU * f64::from(number) / 3.0;
            let at = [centre[0] + 200.0 * angle.cos(), centre[1] + 200.0 * angle.sin()];
            let mut hole = star(random, at, [20.0, 160.0]);
            hole.reverse();
            hole
        });
        Region { holes: holes.collect(), outer }
    }

    /// Checks that trimming gives the area of the library, but for what arcs and whole nanometres take along the border.
    fn assert_alike(area: &Area, distance_um: f64) -> Option<Area> {
        let expected = area.library_offset(distance_um, ERROR_UM);
        let found = Area::from_shapes(offset(area, distance_um * 1000.0, ERROR_UM * 1000.0)?);
        let only_um2 = found.subtract(&expected).area_um2() + expected.subtract(&found).area_um2();
        let length_um: f64 = [&found, &expected].map(border_um).iter().sum();
        assert!(
            only_um2 <= length_um * ERROR_UM + 1.0,
            "{distance_um}: {only_um2} µm² differ on {length_um} µm of {area:?}"
        );
        for ring in found.shapes().iter().map(|shape| &shape[0]) {
            assert!(doubled_area_nm2(ring) > 0, "an outer ring is clockwise");
        }
        Some(found)
    }

    fn border_um(area: &Area) -> f64 {
        let border = Border::of(area, Point::new(0, 0));
        border.edges.iter().map(|edge| edge.length / 1000.0).sum()
    }

    #[test]
    fn random_rings_are_offset_as_by_the_library() {
        let mut random = Random(11);
        let (mut trimmed, mut all) = (0, 0);
        for _ in 0..150 {
            let area = Area::of(&region(&mut random));
            // First of the area, then of what that gave, as filling does.
            let first_um = -random.from(1.0, 150.0);
            for (area, distance_um) in [
                (Some(area.clone()), first_um),
                (assert_alike(&area, -30.0), random.from(-120.0, -10.0)),
                (assert_alike(&area, -60.0), 66.0),
                (assert_alike(&area, 20.0), random.from(1.0, 200.0)),
            ] {
                let Some(area) = area.filter(|area| !area.is_empty()) else { continue };
                all += 1;
                trimmed += u32::from(assert_alike(&area, distance_um).is_some());
            }
        }
        assert!(trimmed * 100 >= all * 99, "{trimmed} of {all} trimmed");
    }

    #[test]
    fn right_angles_and_gaps_as_wide_as_the_offset_are_right_or_left_to_the_library() {
        // A comb: edges in line with each other, and gaps and teeth exactly twice the distance wide.
        let mut outer = vec![[0.0, 0.0], [1000.0, 0.0]];
        for tooth in (0..5).rev() {
            let low = 200.0 * f64::from(tooth);
            outer.extend([[low + 200.0, 500.0], [low + 100.0, 500.0], [low + 100.0, 200.0], [low, 200.0]]);
        }
        let area = Area::of(&Region { outer, holes: Vec::new() });
        for distance_um in [-10.0, -49.999, -50.0, -50.001, -100.0, 10.0, 49.999, 50.0, 50.001] {
            assert_alike(&area, distance_um);
        }
    }

    #[test]
    fn small_turns_keep_one_point_each() {
        // Seen from inside, the hole is round: each of its corners would get an arc.
        let circle = |radius: f64, way: f64| {
            let angle = move |number| way * TAU * f64::from(number) / 90.0;
            (0..90).map(move |number| [5000.0 + radius * angle(number).cos(), 5000.0 + radius * angle(number).sin()])
        };
        let region = Region { outer: circle(900.0, 1.0).collect(), holes: vec![circle(400.0, -1.0).collect()] };
        let found = assert_alike(&Area::of(&region), -60.0).expect("nothing touches");
        assert_eq!(found.rings().map(Vec::len).collect::<Vec<_>>(), [90, 90]);
    }
}
