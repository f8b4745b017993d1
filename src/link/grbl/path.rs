//! The path of the beam that a grbl controller was sent, and where on it the beam is. The controller says how far it has read, but not
//! how far it has moved: only its position tells that. `tests/grbl/main.rs` prints with it.

use std::collections::VecDeque;

/// Blocks that the controller may still carry out behind its planner: those whose steps are prepared.
const PREPARED_BLOCKS: usize = 12;

/// A straight move that was sent.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stretch {
    from_um: [i32; 2],
    to_um: [i32; 2],
    /// The vector that it marks; `None` for a jump.
    vector: Option<u32>,
    /// How long the laser is on, at full speed, microseconds.
    laser_us: u64,
}

/// Where the beam came to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rest {
    /// The first vector that is not marked whole.
    pub(super) next_vector: u32,
    /// Whether part of that vector may be marked.
    pub(super) is_broken: bool,
    /// Where in that vector the laser went off, if the position tells that: it lies on the path, and at one place of it only.
    pub(super) broken_um: Option<[i32; 2]>,
    /// How long the laser was on for whole vectors, microseconds.
    pub(super) laser_us: u64,
}

/// The moves that may not have been carried out yet, oldest first.
#[derive(Clone, Debug)]
pub(super) struct Path {
    stretches: VecDeque<Stretch>,
    end_um: [i32; 2],
    /// Of the moves, the number that the controller has answered.
    answered: usize,
    /// Of the answered ones, the number of those that certainly take a block of the planner.
    blocks: usize,
    planner_blocks: usize,
    tolerance_um: f64,
    /// Of vectors that were certainly marked: the first one behind them, and how long the laser was on, microseconds.
    next_vector: u32,
    laser_us: u64,
}

impl Path {
    /// A path that starts here, with `next_vector`. `tolerance_um`: how far a reported position may lie beside it.
    pub(super) fn new(start_um: [i32; 2], next_vector: u32, planner_blocks: usize, tolerance_um: f64) -> Self {
        Self {
            stretches: VecDeque::new(),
            end_um: start_um,
            answered: 0,
            blocks: 0,
            planner_blocks,
            tolerance_um,
            next_vector,
            laser_us: 0,
        }
    }

    /// A jump was sent. It is not of length 0.
    pub(super) fn jump(&mut self, to_um: [i32; 2]) {
        self.push(to_um, None, 0);
    }

    /// A mark of a vector was sent, during which the laser is on for so long, microseconds. It is not of length 0.
    pub(super) fn mark(&mut self, to_um: [i32; 2], vector: u32, laser_us: u64) {
        self.push(to_um, Some(vector), laser_us);
    }

    fn push(&mut self, to_um: [i32; 2], vector: Option<u32>, laser_us: u64) {
        self.stretches.push_back(Stretch { from_um: self.end_um, to_um, vector, laser_us });
        self.end_um = to_um;
    }

    /// Where the path ends that was sent.
    pub(super) fn end_um(&self) -> [i32; 2] {
        self.end_um
    }

    /// Whether the beam, which is here, is at the end.
    pub(super) fn is_at_end(&self, at_um: [i32; 2]) -> bool {
        length_um(self.end_um, at_um) <= self.tolerance_um
    }

    /// The controller has read the oldest move that it had not answered. Moves that no longer fit into its planner are done.
    pub(super) fn answered(&mut self) {
        if let Some(stretch) = self.stretches.get(self.answered) {
            self.blocks += usize::from(self.takes_block(stretch));
            self.answered += 1;
        }
        while self.blocks > self.planner_blocks + PREPARED_BLOCKS {
            self.pass();
        }
    }

    /// Whether a move is long enough to be planned: one of less than a step is left out.
    fn takes_block(&self, stretch: &Stretch) -> bool {
        length_um(stretch.from_um, stretch.to_um) > self.tolerance_um
    }

    /// The controller has refused a move. Those behind it do not lie where they should.
    pub(super) fn refused(&mut self) {
        self.withdraw(self.stretches.len() - self.answered);
    }

    /// The last moves were not sent after all.
    pub(super) fn withdraw(&mut self, count: usize) {
        for _ in 0..count {
            if let Some(stretch) = self.stretches.pop_back() {
                self.end_um = stretch.from_um;
            }
        }
    }

    /// Everything that was sent is done.
    pub(super) fn complete(&mut self) {
        while !self.stretches.is_empty() {
            self.pass();
        }
    }

    /// The first vector that is not known to be marked.
    pub(super) fn next_vector(&self) -> u32 {
        self.next_vector
    }

    /// How long the laser was on for the vectors before, microseconds.
    pub(super) fn laser_us(&self) -> u64 {
        self.laser_us
    }

    /// The oldest move is done.
    fn pass(&mut self) {
        if let Some(stretch) = self.stretches.pop_front() {
            if self.answered > 0 {
                self.answered -= 1;
                self.blocks -= usize::from(self.takes_block(&stretch));
            }
            if let Some(vector) = stretch.vector {
                self.next_vector = vector + 1;
                self.laser_us += stretch.laser_us;
            }
        }
    }

    /// The beam was seen here while it moves. Returns whether that can be; then the moves before are done.
    pub(super) fn seen(&mut self, at_um: [i32; 2]) -> bool {
        let Some(place) = self.stretches.iter().position(|stretch| self.is_on(stretch, at_um)) else {
            return self.stretches.is_empty();
        };
        for _ in 0..place {
            self.pass();
        }
        true
    }

    fn is_on(&self, stretch: &Stretch, at_um: [i32; 2]) -> bool {
        distance_um(stretch, at_um) <= self.tolerance_um
    }

    /// The beam has come to rest here. `is_cut`: the controller was reset, so it may have stopped anywhere. Otherwise it has done what
    /// it has answered, and of the rest what reached it.
    pub(super) fn rest(&self, at_um: [i32; 2], is_cut: bool) -> Rest {
        let ends = || self.rest_at_end(at_um);
        match is_cut {
            true => self.rest_anywhere(at_um),
            // A reset may have gone unnoticed while the line was down.
            false => ends().unwrap_or_else(|| self.rest_anywhere(at_um)),
        }
    }

    /// The beam rests at the end of a move; `None` if none ends there.
    fn rest_at_end(&self, at_um: [i32; 2]) -> Option<Rest> {
        let is_here = |point_um: [i32; 2]| length_um(point_um, at_um) <= self.tolerance_um;
        let first = self.stretches.front()?;
        // After so many moves.
        let done_before = self.answered;
        let starts = (done_before == 0 && is_here(first.from_um)).then_some(0);
        let ends = (done_before.max(1)..=self.stretches.len()).filter(|count| is_here(self.stretches[count - 1].to_um));
        let mut counts = starts.into_iter().chain(ends);
        let count = counts.next()?;
        let is_certain = counts.next().is_none();
        let (next_vector, laser_us) = self.after(count);
        Some(Rest { next_vector, is_broken: !is_certain, broken_um: None, laser_us })
    }

    /// The first vector that is not marked after so many moves, and the laser's time.
    fn after(&self, count: usize) -> (u32, u64) {
        self.stretches.iter().take(count).fold((self.next_vector, self.laser_us), |(next, us), stretch| {
            stretch.vector.map_or((next, us), |vector| (vector + 1, us + stretch.laser_us))
        })
    }

    fn rest_anywhere(&self, at_um: [i32; 2]) -> Rest {
        let on: Vec<usize> =
            (0..self.stretches.len()).filter(|&place| self.is_on(&self.stretches[place], at_um)).collect();
        let Some(&first) = on.first() else {
            let is_empty = self.stretches.is_empty();
            let (next_vector, laser_us) = (self.next_vector, self.laser_us);
            return Rest { next_vector, is_broken: !is_empty, broken_um: None, laser_us };
        };
        // One place of the way: the moves that it lies on meet there.
        let is_certain = on.windows(2).all(|pair| {
            let (before, after) = (pair[0], pair[1]);
            after == before + 1 && length_um(self.stretches[before].to_um, at_um) <= 2.0 * self.tolerance_um
        });
        // At a vector that is shorter than what positions can tell, nobody knows whether it was marked.
        let is_short = |place: &usize| {
            let stretch = &self.stretches[*place];
            stretch.vector.is_some() && length_um(stretch.from_um, stretch.to_um) <= 2.0 * self.tolerance_um
        };
        let is_certain = is_certain && !on.iter().any(is_short);
        let last = if is_certain { on[on.len() - 1] } else { first };
        let stretch = &self.stretches[last];
        let is_begun = stretch.vector.is_some() && length_um(stretch.from_um, at_um) > self.tolerance_um;
        let is_ended = length_um(stretch.to_um, at_um) <= self.tolerance_um;
        let (next_vector, laser_us) = self.after(last + usize::from(is_ended));
        let is_inside = is_begun && !is_ended;
        let broken_um = (is_certain && is_inside).then_some(at_um);
        Rest { next_vector, is_broken: !is_certain || is_inside, broken_um, laser_us }
    }
}

pub(super) fn length_um(from_um: [i32; 2], to_um: [i32; 2]) -> f64 {
    let [x, y] = [0, 1].map(|axis| f64::from(to_um[axis]) - f64::from(from_um[axis]));
    x.hypot(y)
}

/// Distance of a point from a move.
fn distance_um(stretch: &Stretch, at_um: [i32; 2]) -> f64 {
    let [from, to, at] = [stretch.from_um, stretch.to_um, at_um].map(|point| point.map(f64::from));
    let (along, beside) = ([to[0] - from[0], to[1] - from[1]], [at[0] - from[0], at[1] - from[1]]);
    let square = along[0] * along[0] + along[1] * along[1];
    let share =
        if square > 0.0 { ((along[0] * beside[0] + along[1] * beside[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    (beside[0] - share * along[0]).hypot(beside[1] - share * along[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A jump to the first of two hatches, the hatch, a jump, and the other hatch.
    fn hatches() -> Path {
        let mut path = Path::new([0, 0], 7, 15, 10.0);
        path.jump([1000, 1000]);
        path.mark([5000, 1000], 7, 100);
        path.jump([5000, 1060]);
        path.mark([1000, 1060], 8, 100);
        path
    }

    fn rest(path: &Path, at_um: [i32; 2], is_cut: bool) -> (u32, bool, bool) {
        let rest = path.rest(at_um, is_cut);
        (rest.next_vector, rest.is_broken, rest.broken_um.is_some())
    }

    #[test]
    fn a_controller_that_ran_dry_rests_at_the_end_of_a_move() {
        let mut path = hatches();
        assert_eq!(rest(&path, [0, 0], false), (7, false, false));
        assert_eq!(rest(&path, [1000, 1000], false), (7, false, false));
        assert_eq!(rest(&path, [5001, 999], false), (8, false, false));
        assert_eq!(rest(&path, [1000, 1060], false), (9, false, false));
        path.answered();
        path.answered();
        assert_eq!(rest(&path, [5000, 1060], false), (8, false, false));
        assert_eq!(path.rest([1000, 1060], false).laser_us, 200);
    }

    #[test]
    fn a_reset_may_stop_the_beam_anywhere() {
        let path = hatches();
        assert_eq!(rest(&path, [500, 500], true), (7, false, false));
        let broken = path.rest([3000, 1004], true);
        assert_eq!((broken.next_vector, broken.broken_um), (7, Some([3000, 1004])));
        assert_eq!(rest(&path, [5000, 1030], true), (8, false, false));
        assert_eq!(rest(&path, [3000, 1060], true), (8, true, true));
        // It went unnoticed.
        assert_eq!(rest(&path, [3000, 1060], false), (8, true, true));
    }

    #[test]
    fn a_position_that_tells_nothing_is_not_trusted() {
        let path = hatches();
        assert_eq!(rest(&path, [3000, 3000], true), (7, true, false));
        // A ring that ends where it begins.
        let mut ring = Path::new([0, 0], 0, 15, 10.0);
        for (vector, corner) in [[900, 0], [900, 900], [0, 0]].into_iter().enumerate() {
            ring.mark(corner, vector as u32, 1);
        }
        assert_eq!(rest(&ring, [0, 0], false), (0, true, false));
        // Once its first side is answered, the ring is whole.
        ring.answered();
        assert_eq!(rest(&ring, [0, 0], false), (3, false, false));
    }

    #[test]
    fn moves_that_were_not_sent_are_taken_off_its_end() {
        let mut path = hatches();
        path.withdraw(2);
        assert_eq!(path.end_um(), [5000, 1000]);
        path.answered();
        path.refused();
        assert_eq!(path.end_um(), [1000, 1000]);
    }

    #[test]
    fn positions_and_answers_tell_how_far_the_beam_is_at_least() {
        let mut path = hatches();
        assert!(path.seen([3000, 1000]));
        assert_eq!(path.next_vector(), 7);
        assert!(path.seen([3000, 1060]));
        assert_eq!(path.next_vector(), 8);
        assert!(!path.seen([3000, 1000]), "it never goes back");
        let mut long = Path::new([0, 0], 0, 15, 10.0);
        (0..40).for_each(|vector| long.mark([(vector as i32 + 1) * 100, 0], vector, 1));
        (0..40).for_each(|_| long.answered());
        assert_eq!(long.next_vector(), 40 - 15 - 12);
        long.complete();
        assert_eq!((long.next_vector(), long.laser_us()), (40, 40));
    }
}
