//! In which order a layer is marked, so that the laser jumps little. `pen` uses it.
//!
//! A stop is what is marked without a choice in between: a contour, a centre line, a point, or a part of the hatches. It can be entered at
//! some of its points: a contour at any, a line at both ends. The order is found in three steps, each with bounded effort:
//!
//! 1. Greedy: go to the nearest stop that is left, by any of its ways. `tree` finds it.
//! 2. Improve (`tour`): at most [`MAX_PASSES`] times over all stops, turn around a stretch of the tour, or move up to three stops to
//!    another place, if that shortens the tour. Only places near the stop are tried.
//! 3. Choose anew where each stop is entered, the best for this order.
//!
//! No step depends on chance or on time, so a layer is ordered alike in every run.

use std::ops::Range;

use super::tour::Tour;
use super::tree::Tree;

/// How often the tour is improved. The third pass finds less than 0.3 % more on layers of lattices.
const MAX_PASSES: u32 = 3;

/// Where a stop is entered, and where it is left.
pub(super) type Way = [[i32; 2]; 2];

/// The stops of a layer, and the ways through each.
#[derive(Debug, Default)]
pub(super) struct Stops {
    ways: Vec<Way>,
    /// End of each stop's ways.
    ends: Vec<u32>,
    /// Whether each stop can be marked backwards: then way `n ^ 1`, or `n` if it ends where it begins, is the reverse of way `n`.
    turns: Vec<bool>,
}

/// A stop in a tour: its number, and which of its ways is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Visit {
    pub(super) stop: u32,
    pub(super) way: u32,
}

impl Stops {
    /// No stops, and room for this many stops and ways.
    pub(super) fn with_capacity(stops: usize, ways: usize) -> Self {
        Self { ways: Vec::with_capacity(ways), ends: Vec::with_capacity(stops), turns: Vec::with_capacity(stops) }
    }

    /// Adds a stop with at least one way. `turns`: ways 0 and 1, 2 and 3 and so on are reverses of each other, or each way ends where it
    /// begins.
    pub(super) fn push(&mut self, ways: impl IntoIterator<Item = Way>, turns: bool) {
        self.ways.extend(ways);
        self.ends.push(self.ways.len() as u32);
        self.turns.push(turns);
    }

    /// Number of stops.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Where the ways of a stop are among those of all stops.
    pub(super) fn range(&self, stop: u32) -> Range<usize> {
        let begin = if stop == 0 { 0 } else { self.ends[stop as usize - 1] };
        begin as usize..self.ends[stop as usize] as usize
    }

    /// Number of ways of all stops.
    pub(super) fn way_count(&self) -> usize {
        self.ways.len()
    }

    /// The ways of a stop.
    fn ways(&self, stop: u32) -> &[Way] {
        &self.ways[self.range(stop)]
    }

    /// Where a visit enters and leaves its stop.
    pub(super) fn way(&self, visit: Visit) -> Way {
        self.ways(visit.stop)[visit.way as usize]
    }

    /// The visit in the other direction; `None` if the stop cannot be marked backwards.
    pub(super) fn turned(&self, visit: Visit) -> Option<Visit> {
        let [from, to] = self.way(visit);
        let way = if from == to { visit.way } else { visit.way ^ 1 };
        self.turns[visit.stop as usize].then_some(Visit { way, ..visit })
    }

    /// Length of all jumps to the first stop and from stop to stop, micrometres. `at` is where the laser is before, if that is known.
    pub(super) fn jump_um(&self, at: Option<[i32; 2]>, tour: &[Visit]) -> f64 {
        let first = at.zip(tour.first()).map_or(0.0, |(at, first)| distance_um(at, self.way(*first)[0]));
        first + tour.windows(2).map(|pair| distance_um(self.way(pair[0])[1], self.way(pair[1])[0])).sum::<f64>()
    }

    /// Greedy: begins with the stop nearest to a point, and goes on to the nearest one by any of its ways.
    fn greedy(&self, mut at: [i32; 2], tree: &mut Tree<'_>) -> Vec<Visit> {
        let mut tour = Vec::with_capacity(self.len());
        while let Some(visit) = tree.take_nearest(at) {
            at = self.way(visit)[1];
            tour.push(visit);
        }
        tour
    }

    /// A short tour through all stops. `at` is where the laser is before; if that is not known, the tour begins near the field's low corner.
    pub(super) fn ordered(&self, at: Option<[i32; 2]>) -> Vec<Visit> {
        let mut tree = Tree::new(self);
        let greedy = self.greedy(at.unwrap_or_default(), &mut tree);
        tree.put_back();
        let mut tour = Tour::new(self, greedy);
        let near = tour.near(&tree);
        for _ in 0..MAX_PASSES {
            if !tour.improve(&near) {
                break;
            }
        }
        let mut visits = tour.into_visits();
        self.choose_ways(at, &mut visits);
        visits
    }

    /// Chooses the best ways for an order of stops: the shortest path through all ways, from the laser's place, if it is known, to the
    /// last stop.
    fn choose_ways(&self, at: Option<[i32; 2]>, visits: &mut [Visit]) {
        let Some(first) = visits.first() else { return };
        let to_first = |way: &Way| at.map_or(0.0, |at| distance_um(at, way[0]));
        let mut costs: Vec<f64> = self.ways(first.stop).iter().map(to_first).collect();
        // For each way of each stop but the first, the way of the stop before.
        let mut came_from: Vec<u32> = Vec::with_capacity(self.ways.len());
        let mut begins = Vec::with_capacity(visits.len());
        for pair in visits.windows(2) {
            begins.push(came_from.len());
            let before = self.ways(pair[0].stop);
            let next = self.ways(pair[1].stop).iter().map(|way| {
                let cost = |number: usize| costs[number] + distance_um(before[number][1], way[0]);
                let best = (1..before.len()).fold((0, cost(0)), |best, number| {
                    let found = cost(number);
                    if found < best.1 { (number, found) } else { best }
                });
                came_from.push(best.0 as u32);
                best.1
            });
            costs = next.collect();
        }
        let cheapest = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
        let mut way = cheapest as u32;
        for (visit, begin) in visits.iter_mut().skip(1).zip(begins).rev() {
            visit.way = way;
            way = came_from[begin + way as usize];
        }
        visits[0].way = way;
    }
}

/// Distance from one point to another, micrometres.
pub(super) fn distance_um(a: [i32; 2], b: [i32; 2]) -> f64 {
    squared_um2(a, b).sqrt()
}

/// Square of the distance from one point to another.
pub(super) fn squared_um2(a: [i32; 2], b: [i32; 2]) -> f64 {
    let [x, y] = [0, 1].map(|axis| f64::from(a[axis]) - f64::from(b[axis]));
    x * x + y * y
}
