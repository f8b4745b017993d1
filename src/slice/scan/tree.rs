//! Finds the nearest of the points where stops are entered. `order` and `tour` use it.

use super::order::{Stops, Visit, squared_um2};

/// Points of a box that is not divided further.
const LEAF_POINTS: usize = 8;

/// Where stops are entered, in nested boxes. Stops are taken out as they are visited.
pub(super) struct Tree<'a> {
    stops: &'a Stops,
    /// Ordered by box.
    points: Vec<Entry>,
    boxes: Vec<Node>,
    taken: Vec<bool>,
    /// Box that each entry is in.
    leaves: Vec<u32>,
    /// Place in `points` of each way, in the order of the stops' ways.
    places: Vec<u32>,
}

#[derive(Clone, Copy)]
struct Entry {
    at: [i32; 2],
    visit: Visit,
}

/// A box: either two smaller boxes or a few points.
struct Node {
    low: [i32; 2],
    high: [i32; 2],
    begin: u32,
    end: u32,
    /// The first of two boxes; 0 for points.
    halves: [u32; 2],
    parent: u32,
    /// Entries of stops that are not taken.
    left: u32,
}

impl<'a> Tree<'a> {
    pub(super) fn new(stops: &'a Stops) -> Self {
        let visits = (0..stops.len() as u32)
            .flat_map(|stop| (0..stops.range(stop).len() as u32).map(move |way| Visit { stop, way }));
        let mut points: Vec<Entry> = Vec::with_capacity(stops.way_count());
        points.extend(visits.map(|visit| Entry { at: stops.way(visit)[0], visit }));
        let mut tree = Self {
            stops,
            leaves: vec![0; points.len()],
            places: vec![0; points.len()],
            points,
            // A box that is divided has more than LEAF_POINTS points, so none has less than half as many.
            boxes: Vec::with_capacity(4 * stops.way_count() / LEAF_POINTS + 1),
            taken: vec![false; stops.len()],
        };
        if !tree.points.is_empty() {
            tree.divide(0, tree.points.len(), 0);
        }
        for (place, Entry { visit, .. }) in tree.points.iter().enumerate() {
            tree.places[stops.range(visit.stop).start + visit.way as usize] = place as u32;
        }
        tree
    }

    /// Puts all stops back that were taken out.
    pub(super) fn put_back(&mut self) {
        self.taken.fill(false);
        self.boxes.iter_mut().for_each(|node| node.left = node.end - node.begin);
    }

    /// Makes the box of a range of points, and returns its number. Halves at the middle point, so the depth is logarithmic.
    fn divide(&mut self, begin: usize, end: usize, parent: u32) -> u32 {
        let points = &mut self.points[begin..end];
        let corner = |pick: fn(i32, i32) -> i32| {
            points[1..].iter().fold(points[0].at, |at, entry| [pick(at[0], entry.at[0]), pick(at[1], entry.at[1])])
        };
        let (low, high) = (corner(i32::min), corner(i32::max));
        let number = self.boxes.len() as u32;
        let (b, e) = (begin as u32, end as u32);
        self.boxes.push(Node { low, high, begin: b, end: e, halves: [0; 2], parent, left: e - b });
        if end - begin <= LEAF_POINTS {
            self.leaves[begin..end].fill(number);
            return number;
        }
        let axis = usize::from(i64::from(high[1]) - i64::from(low[1]) > i64::from(high[0]) - i64::from(low[0]));
        let middle = points.len() / 2;
        points.select_nth_unstable_by_key(middle, |entry| {
            (entry.at[axis], entry.at[1 - axis], entry.visit.stop, entry.visit.way)
        });
        let halves =
            [(begin, begin + middle), (begin + middle, end)].map(|(begin, end)| self.divide(begin, end, number));
        self.boxes[number as usize].halves = halves;
        number
    }

    /// The nearest entry of a stop that is not taken. Takes the stop out.
    pub(super) fn take_nearest(&mut self, at: [i32; 2]) -> Option<Visit> {
        let mut best: Option<(f64, Visit)> = None;
        self.search(at, &mut |found| {
            // By number if they are equally near, so that the order does not depend on the boxes.
            let key = |(distance, visit): &(f64, Visit)| (*distance, visit.stop, visit.way);
            let nearest = best.filter(|best| key(best) <= key(&found)).unwrap_or(found);
            best = Some(nearest);
            nearest.0
        });
        let (_, visit) = best?;
        self.taken[visit.stop as usize] = true;
        for &place in &self.places[self.stops.range(visit.stop)] {
            let mut number = self.leaves[place as usize];
            loop {
                let node = &mut self.boxes[number as usize];
                node.left -= 1;
                if number == 0 {
                    break;
                }
                number = node.parent;
            }
        }
        Some(visit)
    }

    /// Adds the `count` stops with an entry nearest to a point, but for the stop's own.
    pub(super) fn nearest(&self, at: [i32; 2], own: u32, count: usize, near: &mut Vec<u32>) {
        let mut found: Vec<(f64, u32)> = Vec::with_capacity(count + 1);
        self.search(at, &mut |(distance, visit)| {
            if visit.stop != own && !found.iter().any(|(_, stop)| *stop == visit.stop) {
                let place = found.partition_point(|other| *other <= (distance, visit.stop));
                found.insert(place, (distance, visit.stop));
                found.truncate(count);
            }
            if found.len() < count { f64::INFINITY } else { found[count - 1].0 }
        });
        near.extend(found.iter().map(|(_, stop)| stop));
    }

    /// Shows entries with the square of their distance. `see` returns the largest that is still of interest; farther boxes are left out.
    fn search(&self, at: [i32; 2], see: &mut impl FnMut((f64, Visit)) -> f64) {
        let mut limit = f64::INFINITY;
        let mut open = vec![(0.0, 0_u32)];
        if self.boxes.is_empty() {
            return;
        }
        while let Some((distance, number)) = open.pop() {
            let node = &self.boxes[number as usize];
            if distance > limit || node.left == 0 {
                continue;
            }
            if node.halves[0] == 0 {
                for entry in &self.points[node.begin as usize..node.end as usize] {
                    if !self.taken[entry.visit.stop as usize] {
                        limit = see((squared_um2(at, entry.at), entry.visit));
                    }
                }
                continue;
            }
            let [mut far, mut near] = node.halves.map(|half| (self.boxes[half as usize].squared_um2(at), half));
            if far.0 < near.0 {
                (far, near) = (near, far);
            }
            open.extend([far, near]);
        }
    }
}

impl Node {
    /// Square of the distance from a point to the box.
    fn squared_um2(&self, at: [i32; 2]) -> f64 {
        squared_um2(at, [0, 1].map(|axis| at[axis].clamp(self.low[axis], self.high[axis])))
    }
}
