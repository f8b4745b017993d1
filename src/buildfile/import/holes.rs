//! Closes the holes of a surface: its open edges are chained into loops, and each loop is covered with triangles. `solid_check`, `surface` and `relief` use it;
//! `tests/pack_mesh/holes.rs` has examples.
//!
//! As many open edges begin at a corner as end there, because each triangle is a loop itself. So any walk along them comes back, and
//! whatever triangles there are, they become a closed surface. Where a walk returns to a corner, what it went around since then is a hole of
//! its own: holes that touch at a corner are covered one by one.

use std::collections::HashMap;

use super::open_edges::Edge;
use super::rules::Rules;
use crate::buildfile::model::QUANTUM_FRACTIONS;
use crate::text::count_text;

/// A corner, in fractions of a quantum.
type Corner = [i64; 3];

/// The corners around a hole, at least three, each once, as the triangles that cover it go around.
pub(super) struct Hole {
    corners: Vec<Corner>,
}

/// The holes of a surface that lacks triangles along these edges, which are in order.
pub(super) fn holes(missing: &[Edge]) -> Vec<Hole> {
    // The next edge to be taken from each corner.
    let mut next = HashMap::new();
    for (number, [from, _]) in missing.iter().enumerate().rev() {
        next.insert(*from, number);
    }
    let mut take = |from: Corner| {
        let number = next.get_mut(&from)?;
        let [_, to] = missing.get(*number).filter(|edge| edge[0] == from)?;
        *number += 1;
        Some(*to)
    };
    let mut holes = Vec::new();
    // Where each corner of the walk is in it.
    let mut places = HashMap::new();
    for [start, _] in missing {
        let mut walk = vec![*start];
        places.insert(*start, 0);
        while let Some(to) = walk.last().and_then(|last| take(*last)) {
            if let Some(place) = places.get(&to).copied() {
                holes.push(Hole { corners: walk[place..].to_vec() });
                for corner in walk.drain(place + 1..) {
                    places.remove(&corner);
                }
            } else {
                places.insert(to, walk.len());
                walk.push(to);
            }
        }
        places.clear();
    }
    holes
}

impl Hole {
    /// The triangles that cover it: a fan around its centre. They lie within its convex hull.
    pub(super) fn caps(&self) -> Vec<[Corner; 3]> {
        if let [a, b, c] = *self.corners {
            return vec![[a, b, c]];
        }
        let centre = self.centre();
        let after = self.corners.iter().cycle().skip(1);
        self.corners.iter().zip(after).map(|(corner, after)| [*corner, *after, centre]).collect()
    }

    /// How many triangles cover it.
    pub(super) fn cap_count(&self) -> usize {
        if self.corners.len() == 3 { 1 } else { self.corners.len() }
    }

    /// The mean of its corners, rounded.
    pub(super) fn centre(&self) -> Corner {
        let count = self.corners.len() as i128;
        [0, 1, 2].map(|axis| {
            let sum: i128 = self.corners.iter().map(|corner| i128::from(corner[axis])).sum();
            ((2 * sum + count).div_euclid(2 * count)) as i64
        })
    }

    /// Its width, fractions of a quantum: from the corner farthest from the centre to the one farthest from that.
    pub(super) fn width(&self) -> f64 {
        let distance = |a: &Corner, b: &Corner| {
            let along = [0, 1, 2].map(|axis| (a[axis] - b[axis]) as f64);
            along.iter().map(|along| along * along).sum::<f64>().sqrt()
        };
        let farthest = |from: Corner| {
            self.corners
                .iter()
                .max_by(|a, b| distance(a, &from).total_cmp(&distance(b, &from)))
                .copied()
                .unwrap_or(from)
        };
        let one = farthest(self.centre());
        distance(&one, &farthest(one))
    }
}

/// The holes that were closed.
#[derive(Default)]
pub(super) struct ClosedHoles {
    count: u64,
    /// Triangles that cover them.
    pub(super) cap_count: u64,
    /// The widest: its width, fractions of a quantum, its centre, and the solid.
    widest: Option<(f64, Corner, String)>,
}

impl ClosedHoles {
    /// Adds a hole of the solid that `place` names.
    pub(super) fn add(&mut self, hole: &Hole, place: &str) {
        self.count += 1;
        self.cap_count += hole.cap_count() as u64;
        let width = hole.width();
        if self.widest.as_ref().is_none_or(|(widest, ..)| *widest < width) {
            self.widest = Some((width, hole.centre(), place.to_owned()));
        }
    }

    /// A note for the operator; `None` if there are none.
    pub(super) fn note(&self, rules: &Rules) -> Option<String> {
        let (width, centre, place) = self.widest.as_ref()?;
        let width_mm = width / QUANTUM_FRACTIONS as f64 * rules.quantum_um() / 1000.0;
        let [x, y, z] = rules.source_mm(*centre);
        Some(format!(
            "closed {} with {}; the widest is {width_mm:.3} mm wide, at {x:.4}, {y:.4}, {z:.4} mm of {place}. Look at the layers there \
             with `layerctl slice`; repair the part in the program that made it if they are wrong",
            count_text(self.count, "hole"),
            count_text(self.cap_count, "triangle"),
        ))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::buildfile::import::open_edges::OpenEdges;

    fn edges(triangles: &[[Corner; 3]]) -> OpenEdges {
        let mut edges = OpenEdges::default();
        triangles.iter().for_each(|triangle| edges.add(*triangle));
        edges
    }

    #[test]
    fn holes_that_touch_at_a_corner_are_covered_one_by_one() {
        let a = [[0, 0, 0], [9, 0, 0], [9, 9, 2], [0, 9, 1]];
        let b = [[0, 0, 0], [-9, 0, 0], [-9, -9, 5]];
        // Each is lined with triangles that lead away, to corners of their own.
        let around = |corners: &[Corner]| {
            let count = corners.len();
            (0..count).map(|at| [corners[(at + 1) % count], corners[at], [7, 7, 99]]).collect::<Vec<_>>()
        };
        let surface = [around(&a), around(&b)].concat();
        let found = holes(&edges(&surface).missing().expect("few"));
        let mut sizes: Vec<_> = found.iter().map(|hole| hole.corners.len()).collect();
        sizes.sort_unstable();
        assert_eq!(sizes, [3, 4]);
        let square = found.iter().find(|hole| hole.corners.len() == 4).expect("there is one");
        assert_eq!((square.centre(), square.caps().len()), ([5, 5, 1], 4), "halves are rounded up");
        assert!((square.width() - 166.0_f64.sqrt()).abs() < 1e-9, "{}", square.width());
        let caps: Vec<_> = found.iter().flat_map(Hole::caps).collect();
        assert_eq!(edges(&[surface, caps].concat()).finish(), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn whatever_triangles_there_are_they_become_closed(
            corners in proptest::collection::vec(prop::array::uniform3(0..9_usize), 0..60), seed in any::<i64>(),
        ) {
            let corner = |number: usize| [1, 2, 3].map(|axis| (seed ^ number as i64).wrapping_mul(axis * 7919) % 100);
            let triangles: Vec<_> = corners.iter().map(|numbers| numbers.map(corner)).collect();
            let missing = edges(&triangles).missing().expect("few");
            let found = holes(&missing);
            let caps: Vec<_> = found.iter().flat_map(Hole::caps).collect();
            prop_assert!(caps.len() <= missing.len() && 3 * caps.len() >= missing.len());
            for hole in &found {
                let is_simple = (1..hole.corners.len()).all(|at| !hole.corners[at..].contains(&hole.corners[at - 1]));
                prop_assert!(is_simple && hole.corners.len() > 2, "{:?}", hole.corners);
                for axis in 0..3 {
                    let along = |corners: &[Corner]| corners.iter().map(|corner| corner[axis]).collect::<Vec<_>>();
                    let (low, high) = (along(&hole.corners).into_iter().min(), along(&hole.corners).into_iter().max());
                    let inside = hole.caps().iter().all(|cap| along(cap).iter().all(|at| Some(*at) >= low && Some(*at) <= high));
                    prop_assert!(inside);
                }
            }
            prop_assert_eq!(edges(&[triangles, caps].concat()).finish(), None);
        }
    }
}
