//! Makes a tour through stops shorter by turning and moving stretches. `order` uses it.

use super::order::{Stops, Visit, Way, distance_um};
use super::tree::Tree;

/// How many stops move together.
const MAX_MOVED: usize = 3;

/// How many near ends are tried for each end of a stop.
const MAX_NEAR: usize = 5;

/// Longest stretch of a tour that is turned or shifted by one change, so that the work for each is bounded.
const MAX_STRETCH: usize = 1000;

/// A change that gains less is not worth it, and might be rounding. Without it two changes could undo each other for ever.
const LEAST_GAIN_UM: f64 = 1e-3;

/// For each stop, the stops near its ends.
pub(super) struct Near {
    stops: Vec<u32>,
    /// End of each stop's in `stops`.
    ends: Vec<usize>,
}

/// A tour that is being improved.
pub(super) struct Tour<'a> {
    stops: &'a Stops,
    visits: Vec<Visit>,
    /// Where each visit enters and leaves its stop.
    ways: Vec<Way>,
    /// Where in `visits` each stop is.
    places: Vec<u32>,
}

impl<'a> Tour<'a> {
    pub(super) fn new(stops: &'a Stops, visits: Vec<Visit>) -> Self {
        let ways = visits.iter().map(|visit| stops.way(*visit)).collect();
        let mut tour = Self { stops, places: vec![0; visits.len()], ways, visits };
        tour.note_places(0, tour.visits.len());
        tour
    }

    pub(super) fn into_visits(self) -> Vec<Visit> {
        self.visits
    }

    fn note_places(&mut self, begin: usize, end: usize) {
        for place in begin..end {
            self.places[self.visits[place].stop as usize] = place as u32;
        }
    }

    fn enter(&self, place: usize) -> [i32; 2] {
        self.ways[place][0]
    }

    fn leave(&self, place: usize) -> [i32; 2] {
        self.ways[place][1]
    }

    /// Jump from one place to the next; none before the first and behind the last.
    fn jump(&self, from: Option<usize>, to: usize) -> f64 {
        match from {
            Some(from) if to < self.visits.len() => distance_um(self.leave(from), self.enter(to)),
            _ => 0.0,
        }
    }

    /// The stops near the two ends of each stop.
    pub(super) fn near(&self, tree: &Tree<'_>) -> Near {
        let count = self.visits.len();
        let mut near = Near { stops: Vec::with_capacity(2 * MAX_NEAR * count), ends: Vec::with_capacity(count) };
        let mut found = Vec::with_capacity(2 * MAX_NEAR);
        for stop in 0..self.visits.len() as u32 {
            let [enter, leave] = self.ways[self.places[stop as usize] as usize];
            found.clear();
            tree.nearest(enter, stop, MAX_NEAR, &mut found);
            if enter != leave {
                tree.nearest(leave, stop, MAX_NEAR, &mut found);
            }
            found.sort_unstable();
            found.dedup();
            near.stops.extend_from_slice(&found);
            near.ends.push(near.stops.len());
        }
        near
    }

    /// Goes once over all stops. Returns whether the tour has become shorter.
    pub(super) fn improve(&mut self, near: &Near) -> bool {
        let mut better = false;
        let mut begin = 0;
        for (stop, &end) in near.ends.iter().enumerate() {
            for &other in &near.stops[begin..end] {
                let (here, there) = (self.places[stop] as usize, self.places[other as usize] as usize);
                better |=
                    self.turn(here, there) || self.move_behind(here, there) || self.move_behind_turned(here, there);
            }
            begin = end;
        }
        better
    }

    /// Turns the stretch between two places, so that one is followed by the other, if that is shorter.
    fn turn(&mut self, here: usize, there: usize) -> bool {
        let (low, high) = (here.min(there), here.max(there));
        self.turn_stretch(low + 1, high) || self.turn_stretch(low, high - 1)
    }

    /// Turns the stretch from `first` to `last` if that is shorter.
    fn turn_stretch(&mut self, first: usize, last: usize) -> bool {
        if first >= last || last - first > MAX_STRETCH {
            return false;
        }
        let before = first.checked_sub(1);
        let old = self.jump(before, first) + self.jump(Some(last), last + 1);
        let mut new = 0.0;
        if let Some(before) = before {
            new += distance_um(self.leave(before), self.leave(last));
        }
        if last + 1 < self.visits.len() {
            new += distance_um(self.enter(first), self.enter(last + 1));
        }
        if new >= old - LEAST_GAIN_UM {
            return false;
        }
        if !self.turn_around(first, last + 1) {
            return false;
        }
        self.note_places(first, last + 1);
        true
    }

    /// Moves one to three stops that begin at `there` to behind `here`, if that is shorter.
    fn move_behind(&mut self, here: usize, there: usize) -> bool {
        (1..=MAX_MOVED).any(|count| self.move_stretch(here, there, count, false))
    }

    /// Moves one to three stops that end at `there` to behind `here`, backwards, if that is shorter.
    fn move_behind_turned(&mut self, here: usize, there: usize) -> bool {
        (1..=MAX_MOVED).any(|count| there + 1 >= count && self.move_stretch(here, there + 1 - count, count, true))
    }

    fn move_stretch(&mut self, here: usize, first: usize, count: usize, turned: bool) -> bool {
        let end = first + count;
        let is_inside = here + 1 >= first && here < end;
        if end > self.visits.len() || is_inside || here.abs_diff(first) > MAX_STRETCH {
            return false;
        }
        let before = first.checked_sub(1);
        let gap = self.jump(before, end);
        let old = self.jump(before, first) + self.jump(Some(end - 1), end) + self.jump(Some(here), here + 1);
        let (enter, leave) =
            if turned { (self.leave(end - 1), self.enter(first)) } else { (self.enter(first), self.leave(end - 1)) };
        let mut new = gap + distance_um(self.leave(here), enter);
        if here + 1 < self.visits.len() {
            new += distance_um(leave, self.enter(here + 1));
        }
        if new >= old - LEAST_GAIN_UM {
            return false;
        }
        if turned && !self.turn_around(first, end) {
            return false;
        }
        if here < first {
            self.visits[here + 1..end].rotate_right(count);
            self.ways[here + 1..end].rotate_right(count);
            self.note_places(here + 1, end);
        } else {
            self.visits[first..=here].rotate_left(count);
            self.ways[first..=here].rotate_left(count);
            self.note_places(first, here + 1);
        }
        true
    }

    /// Turns a stretch around, without noting places. Returns false, and changes nothing, if one of its stops cannot be turned.
    fn turn_around(&mut self, begin: usize, end: usize) -> bool {
        let stops = self.stops;
        if !self.visits[begin..end].iter().all(|visit| stops.turned(*visit).is_some()) {
            return false;
        }
        self.visits[begin..end].reverse();
        self.ways[begin..end].reverse();
        for place in begin..end {
            self.visits[place] = stops.turned(self.visits[place]).unwrap_or(self.visits[place]);
            self.ways[place].reverse();
        }
        true
    }
}
