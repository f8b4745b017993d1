//! How long axes take that move the beam themselves. A grbl controller plans some moves ahead, and slows down at corners.
//! `pipeline/part.rs` uses it, and `tests/grbl/main.rs` compares it with a controller.

use crate::layer::{LaserParameters, MarkClass, Vectors};

/// Deviation at corners with which a controller plans, micrometres: the default of grbl's `$11`.
const JUNCTION_UM: f64 = 10.0;
/// Moves that a controller plans ahead: grbl 1.1 has 15.
const PLANNED: usize = 15;
/// Length of the mark that stands for a point, micrometres.
const POINT_UM: f64 = 40.0;
/// Bytes of a line for a mark and for a jump, about.
const MARK_BYTES: f64 = 26.0;
const JUMP_BYTES: f64 = 17.0;
/// Lines in the receive buffer behind those that are planned: grbl 1.1 has room for 127 bytes.
const LINES_KEPT: usize = 5;

/// What decides how long axes take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxesMotion {
    /// Greatest speed of an axis, micrometres a second.
    pub max_speed_um_s: f64,
    /// Acceleration of an axis, micrometres a second squared.
    pub acceleration_um_s2: f64,
    /// Rate of the line to the controller, bits a second.
    pub baud: u32,
}

/// A straight move.
#[derive(Clone, Copy, Debug)]
struct Move {
    length_um: f64,
    /// Of length 1.
    direction: [f64; 2],
    /// Square of the greatest speed, and the acceleration along it.
    speed_2: f64,
    acceleration: f64,
    is_jump: bool,
}

/// Memory that the moves of a mark take while their time is computed, bytes: a jump and a mark, each with its corner and three times, in
/// lists that grow by doubling.
pub const BYTES_PER_MARK: u64 = 6 * (size_of::<Move>() + 4 * size_of::<f64>()) as u64 + 64;

/// How long the laser is on, and how long marking takes, microseconds, from `from_um`, if that is known. The laser's time is what it would be
/// at full speed: its power follows the speed. Delays of scanners do not apply. The formulas of corners are those of grbl's planner (Jeon
/// 2011, "Improving grbl: cornering algorithm").
pub(super) fn times_us(
    vectors: &Vectors,
    lasers: &[LaserParameters; MarkClass::ALL.len()],
    motion: &AxesMotion,
    from_um: Option<[i32; 2]>,
) -> (f64, f64) {
    let (moves, laser_us) = moves(vectors, lasers, motion, from_um);
    (laser_us, planned_s(&moves, motion.baud) * 1e6)
}

/// The moves of a layer, jumps included, and how long the laser is on at full speed, microseconds.
fn moves(
    vectors: &Vectors,
    lasers: &[LaserParameters; MarkClass::ALL.len()],
    motion: &AxesMotion,
    mut at_um: Option<[i32; 2]>,
) -> (Vec<Move>, f64) {
    let (mut moves, mut laser_us) = (Vec::new(), 0.0);
    for mark in vectors.marks() {
        let laser = &lasers[mark.class as usize];
        if let Some(at_um) = at_um.filter(|at_um| *at_um != mark.from_um) {
            moves.extend(Move::new(at_um, mark.from_um, f64::INFINITY, motion));
        }
        at_um = Some(mark.to_um);
        if mark.from_um == mark.to_um {
            laser_us += f64::from(laser.point_time_us);
            let speed_um_s = POINT_UM * 1e6 / f64::from(laser.point_time_us.max(1));
            moves.extend(Move::along([POINT_UM, 0.0], speed_um_s, motion));
        } else {
            let speed_um_s = f64::from(laser.mark_speed_um_s.max(1));
            let planned = Move::new(mark.from_um, mark.to_um, speed_um_s, motion);
            laser_us += planned.map_or(0.0, |planned| planned.length_um * 1e6 / speed_um_s);
            moves.extend(planned);
        }
    }
    (moves, laser_us)
}

impl Move {
    /// `None` if it goes nowhere.
    fn new(from_um: [i32; 2], to_um: [i32; 2], speed_um_s: f64, motion: &AxesMotion) -> Option<Self> {
        Self::along([0, 1].map(|axis| f64::from(to_um[axis]) - f64::from(from_um[axis])), speed_um_s, motion)
    }

    fn along(way_um: [f64; 2], speed_um_s: f64, motion: &AxesMotion) -> Option<Self> {
        let length_um = way_um[0].hypot(way_um[1]);
        let direction = way_um.map(|um| um / length_um);
        let steepest = direction[0].abs().max(direction[1].abs());
        (length_um > 0.0).then(|| Self {
            length_um,
            direction,
            speed_2: speed_um_s.min(motion.max_speed_um_s / steepest).powi(2),
            acceleration: motion.acceleration_um_s2 / steepest,
            is_jump: speed_um_s.is_infinite(),
        })
    }

    /// Square of the greatest speed at the corner between this move and the next.
    fn corner_2(&self, next: &Self, acceleration: f64) -> f64 {
        let cosine = -(self.direction[0] * next.direction[0] + self.direction[1] * next.direction[1]);
        let sine_half = (0.5 * (1.0 - cosine)).max(0.0).sqrt();
        let limit_2 = self.speed_2.min(next.speed_2);
        match cosine {
            _ if cosine > 0.999_999 => 0.0,
            _ if cosine < -0.999_999 => limit_2,
            _ => limit_2.min(acceleration * JUNCTION_UM * sine_half / (1.0 - sine_half)),
        }
    }
}

/// How long the moves take from rest to rest, seconds, when their lines come at this rate.
fn planned_s(moves: &[Move], baud: u32) -> f64 {
    let mut lines = Lines::new(baud);
    // Squares of the greatest speeds at which moves may begin.
    let corners_2: Vec<f64> = std::iter::once(0.0)
        .chain(moves.windows(2).map(|pair| pair[0].corner_2(&pair[1], pair[0].acceleration.min(pair[1].acceleration))))
        .collect();
    let (mut now_s, mut begin_2) = (0.0, 0.0);
    for (place, move_) in moves.iter().enumerate() {
        // The controller plans again with each line that comes before the move must brake.
        let known = lines.known(place, moves, now_s + move_.time_s(begin_2, 0.0) / 2.0);
        now_s = f64::max(now_s, lines.taken_s[place]);
        // Behind the last move that it knows, the controller must be able to stand.
        let mut end_2 = 0.0;
        for next in (place + 1..known).rev() {
            end_2 = f64::min(corners_2[next], end_2 + moves[next].reach_2());
        }
        end_2 = end_2.min(begin_2 + move_.reach_2());
        now_s += move_.time_s(begin_2, end_2);
        lines.done_s.push(now_s);
        begin_2 = end_2;
    }
    now_s
}

/// When the lines of moves arrive. A controller takes a line when its planner has room, and keeps some bytes of those behind it.
struct Lines {
    byte_s: f64,
    /// When each line has come, and when the planner has taken it, seconds.
    come_s: Vec<f64>,
    taken_s: Vec<f64>,
    /// When each move is done.
    done_s: Vec<f64>,
}

impl Lines {
    fn new(baud: u32) -> Self {
        Self { byte_s: 10.0 / f64::from(baud.max(1)), come_s: Vec::new(), taken_s: Vec::new(), done_s: Vec::new() }
    }

    /// The number of moves that the controller knows at a time, when all before `place` are done; at least up to this one.
    fn known(&mut self, place: usize, moves: &[Move], now_s: f64) -> usize {
        // With so many before it, the planner is full.
        while self.taken_s.len() < moves.len().min(place + PLANNED) {
            let number = self.taken_s.len();
            let bytes = if moves[number].is_jump { JUMP_BYTES } else { MARK_BYTES };
            let has_room_s = number.checked_sub(LINES_KEPT).map_or(0.0, |before| self.taken_s[before]);
            let free_s = self.come_s.last().copied().unwrap_or(0.0);
            let come_s = f64::max(has_room_s, free_s) + bytes * self.byte_s;
            let planned_s = number.checked_sub(PLANNED).map_or(0.0, |before| self.done_s[before]);
            self.come_s.push(come_s);
            self.taken_s.push(come_s.max(planned_s));
        }
        let known = self.taken_s[place..].iter().take_while(|taken_s| **taken_s <= now_s).count();
        place + known.max(1)
    }
}

impl Move {
    /// By how much the square of its speed may change along it.
    fn reach_2(&self) -> f64 {
        2.0 * self.acceleration * self.length_um
    }

    /// How long it takes between these squares of speeds, seconds.
    fn time_s(&self, begin_2: f64, end_2: f64) -> f64 {
        let peak_2 = (0.5 * (begin_2 + end_2) + self.acceleration * self.length_um).min(self.speed_2);
        let [begin, end, peak] = [begin_2, end_2, peak_2].map(|square| square.max(0.0).sqrt());
        let ramps_um = (2.0 * peak_2 - begin_2 - end_2) / (2.0 * self.acceleration);
        let ramps_s = (2.0 * peak - begin - end) / self.acceleration;
        ramps_s + (self.length_um - ramps_um).max(0.0) / peak.max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::ScanTimes;

    const MOTION: AxesMotion = AxesMotion { max_speed_um_s: 200_000.0, acceleration_um_s2: 1_000_000.0, baud: 115_200 };

    fn mark_ms(points_um: &[[i32; 2]], speed_um_s: u32) -> u32 {
        let laser = LaserParameters { mark_speed_um_s: speed_um_s, ..LaserParameters::default() };
        let mut vectors = Vectors::default();
        vectors.push_path(MarkClass::Contour, points_um);
        ScanTimes::of(&vectors, &[laser; MarkClass::ALL.len()], Some(&MOTION)).mark_ms
    }

    #[test]
    fn a_line_from_rest_to_rest() {
        // 100 mm at 100 mm/s, and 0.1 s for each of the two ramps, of which half is lost. The line of the first move takes 2 ms.
        assert_eq!(mark_ms(&[[0, 0], [100_000, 0]], 100_000), 1_102);
        // Never at full speed: 10 mm with 1 m/s².
        assert_eq!(mark_ms(&[[0, 0], [10_000, 0]], 200_000), 202);
    }

    #[test]
    fn corners_slow_down_and_turns_stop() {
        let straight = mark_ms(&[[0, 0], [50_000, 0], [100_000, 0]], 100_000);
        assert_eq!(straight, 1_102);
        let corner = mark_ms(&[[0, 0], [50_000, 0], [50_000, 50_000]], 100_000);
        let turn = mark_ms(&[[0, 0], [50_000, 0], [0, 0]], 100_000);
        assert_eq!(turn, 1_202);
        assert!(straight < corner && corner < turn, "{straight} {corner} {turn}");
    }

    #[test]
    fn short_moves_are_limited_by_what_is_planned_ahead_and_by_the_line() {
        // 14 moves of 200 µm: room to stop from 75 mm/s, on a line that is fast enough for that.
        let short: Vec<[i32; 2]> = (0..=1000).map(|place| [place * 200, 0]).collect();
        let short_ms = mark_ms(&short, 200_000);
        assert!((2_660..2_900).contains(&short_ms), "{short_ms}");
        // 1000 lines of 26 bytes at 11,520 bytes a second.
        let tiny: Vec<[i32; 2]> = (0..=1000).map(|place| [place * 40, 0]).collect();
        let tiny_ms = mark_ms(&tiny, 200_000);
        assert!((2_250..2_350).contains(&tiny_ms), "{tiny_ms}");
    }
}
