//! Which stretches of an area's border lie farther than a distance from another area. `thin` and `layer_plan` ask this first, as combining
//! areas takes longer.

use super::border::{Border, Bounds, Spans, Vector, along, dot, line_in_capsule, minus, place};
use super::offset::Area;
use super::path::ring_edges;

/// A stretch of a border, in one piece.
#[derive(Debug, PartialEq)]
pub(super) struct Stretch {
    /// Its ends and the corners between them, nanometres from the first point of the area.
    points: Vec<Vector>,
    /// Whether it is a whole ring, without ends.
    pub(super) is_ring: bool,
}

impl Stretch {
    /// Length, micrometres.
    pub(super) fn length_um(&self) -> f64 {
        self.points.windows(2).map(|pair| distance_um(pair[0], pair[1])).sum()
    }

    /// How far it reaches from its ends: the greatest distance of a corner from the nearer end, micrometres.
    pub(super) fn reach_um(&self) -> f64 {
        let [first, .., last] = self.points[..] else { return 0.0 };
        let reach_um = |point: &Vector| distance_um(*point, first).min(distance_um(*point, last));
        self.points.iter().map(reach_um).fold(0.0, f64::max)
    }
}

fn distance_um(a: Vector, b: Vector) -> f64 {
    let away = minus(a, b);
    dot(away, away).sqrt() / 1000.0
}

/// The stretches of the border of `area` that are at least `reach_um` away from the border of `core`, which lies inside.
pub(super) fn bare_stretches(area: &Area, core: &Area, reach_um: f64) -> Vec<Stretch> {
    let mut found = Vec::new();
    let Some(origin) = area.rings().next().and_then(|ring| ring.first()) else { return found };
    let core = Border::of(core, *origin);
    for ring in area.rings() {
        let first = found.len();
        let mut spans = Spans::default();
        // Whether the last stretch reaches the end of its edge.
        let mut goes_on = false;
        for [from, to] in ring_edges(ring).map(|ends| ends.map(|point| place(*origin, point))) {
            let away = minus(to, from);
            let length = dot(away, away).sqrt();
            if length == 0.0 {
                continue;
            }
            let direction = away.map(|part| part / length);
            spans.begin([0.0, length]);
            core.near(Bounds::of(from, to).grown(reach_um * 1000.0), &mut |number| {
                let edge = &core.edges[number as usize];
                let near = line_in_capsule(from, direction, length, edge, reach_um * 1000.0);
                near.is_none_or(|stretch| spans.remove(stretch))
            });
            for &[low, high] in &spans.left {
                let end = if high == length { to } else { along(from, direction, high) };
                match found.last_mut() {
                    Some(Stretch { points, .. }) if goes_on && low == 0.0 => points.push(end),
                    _ => found.push(Stretch { points: vec![along(from, direction, low), end], is_ring: false }),
                }
                goes_on = high == length;
            }
            goes_on &= !spans.left.is_empty();
        }
        close(&mut found, first, goes_on);
    }
    found
}

/// Joins the last stretch of a ring to its first, if both touch the ring's beginning. The ring's stretches are those from number `first` on.
fn close(found: &mut Vec<Stretch>, first: usize, goes_on: bool) {
    let Some(last) = found[first..].last().map(|stretch| stretch.points[stretch.points.len() - 1]) else { return };
    if !goes_on || found[first].points[0] != last {
        return;
    }
    if found.len() - first == 1 {
        found[first].is_ring = true;
    } else if let Some(Stretch { mut points, .. }) = found.pop() {
        points.pop();
        points.append(&mut found[first].points);
        found[first].points = points;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slice::scan::region::Region;

    fn area(rings: &[&[[f64; 2]]]) -> Area {
        Area::of(&Region { outer: rings[0].to_vec(), holes: rings[1..].iter().map(|ring| ring.to_vec()).collect() })
    }

    #[test]
    fn corners_are_bare_and_reach_as_far_as_geometry_says() {
        // The corner of a square is 100 µm from the core along both sides; a circle of 120 µm around its corner leaves 100 − √(120² − 100²).
        let square = area(&[&[[0.0, 0.0], [1000.0, 0.0], [1000.0, 1000.0], [0.0, 1000.0]]]);
        let core = square.offset(-100.0);
        let stretches = bare_stretches(&square, &core, 120.0);
        let reach_um = 100.0 - (120.0_f64.powi(2) - 100.0_f64.powi(2)).sqrt();
        assert_eq!(stretches.len(), 4);
        for stretch in &stretches {
            assert!(!stretch.is_ring && (stretch.length_um() - 2.0 * reach_um).abs() < 1e-6, "{stretch:?}");
            assert!((stretch.reach_um() - reach_um).abs() < 1e-6, "{stretch:?}");
        }
        assert_eq!(bare_stretches(&square, &core, 142.0), []);
        let all = bare_stretches(&square, &core, 99.0);
        assert!(matches!(all[..], [Stretch { is_ring: true, .. }]) && (all[0].length_um() - 4000.0).abs() < 1e-6);
    }

    #[test]
    fn each_ring_has_its_own_stretches() {
        // A hole near one side: what lies between is farther from the core, which is the lower part.
        let plate = area(&[
            &[[0.0, 0.0], [1000.0, 0.0], [1000.0, 1000.0], [0.0, 1000.0]],
            &[[400.0, 800.0], [400.0, 950.0], [600.0, 950.0], [600.0, 800.0]],
        ]);
        let core = area(&[&[[50.0, 50.0], [950.0, 50.0], [950.0, 700.0], [50.0, 700.0]]]);
        let lengths: Vec<f64> = bare_stretches(&plate, &core, 200.0).iter().map(Stretch::length_um).collect();
        // The upper side with 100 µm of the sides next to it, and the hole above 900 µm.
        let [outer_um, hole_um] = lengths[..] else { panic!("{lengths:?}") };
        assert!((hole_um - 300.0).abs() < 1e-6, "{hole_um}");
        assert!((1180.0..1250.0).contains(&outer_um), "{outer_um}");
    }
}
