//! Geometry of rings for the tests: orientation, crossings, distances.

use layerd::slice::scan::Region;

pub(crate) type Point = [f64; 2];

/// Twice the area of the triangle a, b, c: positive if c is to the left of the line from a to b.
fn turn(a: Point, b: Point, c: Point) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

pub(crate) fn signed_area(ring: &[Point]) -> f64 {
    ring.windows(2).map(|pair| turn(ring[0], pair[0], pair[1]) / 2.0).sum()
}

/// The segments of a ring, the closing one included.
pub(crate) fn segments(ring: &[Point]) -> impl Iterator<Item = [Point; 2]> + Clone + '_ {
    (0..ring.len()).map(|at| [ring[at], ring[(at + 1) % ring.len()]])
}

pub(crate) fn distance_to_segment(point: Point, [a, b]: [Point; 2]) -> f64 {
    let (along, from) = ([b[0] - a[0], b[1] - a[1]], [point[0] - a[0], point[1] - a[1]]);
    let length2 = along[0] * along[0] + along[1] * along[1];
    let share = ((from[0] * along[0] + from[1] * along[1]) / length2).clamp(0.0, 1.0);
    (from[0] - share * along[0]).hypot(from[1] - share * along[1])
}

pub(crate) fn distance_to_ring(point: Point, ring: &[Point]) -> f64 {
    segments(ring).map(|segment| distance_to_segment(point, segment)).fold(f64::INFINITY, f64::min)
}

/// Whether two segments have a point in common. Segments that only share an end have none.
fn meet([a, b]: [Point; 2], [c, d]: [Point; 2]) -> bool {
    let shared = [a, b].into_iter().filter(|end| *end == c || *end == d).count();
    if shared > 0 {
        // Neighbours in a ring: the far end of neither lies on the other.
        let far = |end: &&Point, [from, to]: [Point; 2]| **end != from && **end != to;
        let lies_on = |end: Option<&Point>, segment| end.is_some_and(|end| distance_to_segment(*end, segment) < 1e-9);
        return shared == 2
            || lies_on([a, b].iter().find(|end| far(end, [c, d])), [c, d])
            || lies_on([c, d].iter().find(|end| far(end, [a, b])), [a, b]);
    }
    // Segments of one line are apart if they are so along an axis.
    let apart =
        |axis: usize| a[axis].max(b[axis]) < c[axis].min(d[axis]) || c[axis].max(d[axis]) < a[axis].min(b[axis]);
    let sides = |a, b, c, d| turn(a, b, c) * turn(a, b, d) <= 0.0;
    sides(a, b, c, d) && sides(c, d, a, b) && !apart(0) && !apart(1)
}

/// Two segments of a layer that meet: a sweep along x over all pairs that overlap in x.
pub(crate) fn crossing(regions: &[Region]) -> Option<[[Point; 2]; 2]> {
    let mut all: Vec<[Point; 2]> =
        regions.iter().flat_map(|region| region.rings().flat_map(|ring| segments(ring))).collect();
    let low = |segment: &[Point; 2]| segment[0][0].min(segment[1][0]);
    let high = |segment: &[Point; 2]| segment[0][0].max(segment[1][0]);
    all.sort_by(|one, other| low(one).total_cmp(&low(other)));
    for (at, one) in all.iter().enumerate() {
        let overlapping = all[at + 1..].iter().take_while(|other| low(other) <= high(one));
        if let Some(other) = overlapping.into_iter().find(|other| meet(*one, **other)) {
            return Some([*one, *other]);
        }
    }
    None
}

#[test]
fn crossing_segments_are_found_and_neighbours_are_not() {
    let square = vec![[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]];
    let region = |outer: Vec<Point>| Region { outer, holes: Vec::new() };
    assert_eq!(crossing(&[region(square.clone())]), None);
    let bow_tie = vec![[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]];
    assert!(crossing(&[region(bow_tie)]).is_some());
    let spike = vec![[0.0, 0.0], [4.0, 0.0], [2.0, 0.0], [2.0, 3.0]];
    assert!(crossing(&[region(spike)]).is_some());
    let touching = vec![[4.0, 2.0], [6.0, 1.0], [6.0, 3.0]];
    assert!(crossing(&[region(square), region(touching)]).is_some());
    let in_line = vec![[0.0, 5.0], [0.0, 7.0], [-1.0, 6.0]];
    assert_eq!(crossing(&[region(in_line), region(vec![[0.0, 0.0], [3.0, 1.0], [0.0, 2.0]])]), None);
}
