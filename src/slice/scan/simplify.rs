//! Leaves out points of a ring without changing its topology (after Huang, Wang & Chen 2013, constrained simplification).
//!
//! Each point of a ring lies on an edge of the grid and may slide along it, by at most the tolerance. A run of points is replaced by a
//! segment only if the segment crosses the same edges, in the same order, and passes each point that is left out within the tolerance.
//! Each edge is crossed by one ring and once, and two segments in one cell go around different corners. So segments do not meet, the
//! topology stays that of the picture, and no point of the old ring is farther from the new one than the tolerance, nor the other way
//! round.
//!
//! The area stays the same, too: a segment ends where it cuts off as much as it adds. Chords of the border itself would always lie on
//! the inner side of an arc, and make thin struts thinner by several per cent. What one segment cannot balance, the next ones do.
//!
//! `contours` simplifies the rings of a layer with it. `tests/contours/` checks topology, crossings, tolerance and area.

use super::charged::Charged;
use super::contour::{Along, Crossing, EDGE, PITCH};
use crate::stream::BudgetExceeded;

/// Crossings that are looked at beyond the best end found so far. So the time is proportional to the number of crossings.
const LOOK_AHEAD: usize = 16;

/// Points at the end of a ring that are tried to balance the area of its last segment.
const MAX_BALANCED: usize = 8;

type Vector = [f64; 2];

/// A point that is kept: a crossing of the ring, and where on its edge the point lies, in the units of [`Crossing::at`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Kept {
    crossing: u32,
    at: u16,
}

/// Simplifies rings.
#[derive(Clone, Copy, Debug)]
pub(super) struct Simplifier {
    /// Pitch along x and y, micrometres.
    pub(super) pixel_um: Vector,
    /// Most that a point moves along its edge, micrometres; greater than 0.
    pub(super) tolerance_um: f64,
}

/// The directions in which a segment from a given point passes all edges, and all points within the tolerance.
#[derive(Clone, Copy)]
struct Gate {
    right: Vector,
    left: Vector,
    /// Square of the distance to the farthest point passed. A segment must not end before it.
    farthest2: f64,
}

/// The part of an edge on which a segment may end, in the units of [`Crossing::at`].
#[derive(Clone, Copy)]
struct Range {
    low: f64,
    high: f64,
}

/// A possible end of a segment.
#[derive(Clone, Copy)]
struct End {
    crossing: usize,
    at: u16,
    /// Twice the area by which the ring is too small so far, µm².
    debt: f64,
}

impl Simplifier {
    /// Moves the points that are kept to the front of `ring`, and returns their number. `kept` is memory to work with.
    ///
    /// # Errors
    /// [`BudgetExceeded`] if the memory is not free.
    pub(super) fn simplify(&self, ring: &mut [Crossing], kept: &mut Charged<Kept>) -> Result<usize, BudgetExceeded> {
        kept.clear();
        let mut end = End { crossing: 0, at: ring[0].at, debt: 0.0 };
        while end.crossing < ring.len() {
            kept.push(Kept { crossing: end.crossing as u32, at: end.at })?;
            end = self.next(ring, end);
        }
        self.balance(ring, kept, end.debt);
        for (number, Kept { crossing, at }) in kept.iter().enumerate() {
            ring[number] = Crossing { at: *at, ..ring[*crossing as usize] };
        }
        Ok(kept.len())
    }

    /// The end of the longest segment that begins at `from` and balances the area, or else of the one that comes nearest to it.
    fn next(&self, ring: &[Crossing], from: End) -> End {
        let origin = self.point(&ring[from.crossing], from.at);
        let mut best: Option<(End, bool)> = None;
        let mut gate = None;
        let mut debt = from.debt;
        let mut before = minus(self.point(&ring[from.crossing], ring[from.crossing].at), origin);
        for at in from.crossing + 1..=ring.len() {
            let crossing = &ring[at % ring.len()];
            let here = minus(self.point(crossing, crossing.at), origin);
            debt += cross(before, here);
            before = here;
            let range = self.range(crossing, origin, gate);
            if at == ring.len() {
                // The ring ends where it began.
                let end = End { crossing: at, at: crossing.at, debt };
                if range.is_some_and(|range| range.contains(crossing.at))
                    && self.is_beyond(crossing, end.at, origin, gate)
                {
                    return end;
                }
                break;
            }
            if let Some(range) = range {
                // A slide by u along the edge e adds u · (here × e).
                let gain = cross(here, self.unit(crossing.along));
                let wanted = f64::from(crossing.at) - debt / gain;
                let slid = range.nearest(wanted, crossing.at);
                let exact = (f64::from(slid) - wanted).abs() <= 1.0;
                let debt = debt + gain * (f64::from(slid) - f64::from(crossing.at));
                let is_better =
                    best.is_none_or(
                        |(best, best_is_exact): (End, bool)| {
                            if exact || best_is_exact { exact } else { debt.abs() < best.debt.abs() }
                        },
                    );
                if is_better && self.is_beyond(crossing, slid, origin, gate) {
                    best = Some((End { crossing: at, at: slid, debt }, exact));
                }
            }
            if best.is_some_and(|(best, exact)| exact && at - best.crossing > LOOK_AHEAD) {
                break;
            }
            let Some(passed) = self.pass(crossing, origin, gate) else { break };
            gate = Some(passed);
        }
        // The next edge can always be reached where the border crosses it.
        let next = from.crossing + 1;
        best.map_or(End { crossing: next, at: ring[next % ring.len()].at, debt: from.debt }, |(best, _)| best)
    }

    /// Slides points near the end of the ring so that it has the area that it is to have.
    fn balance(&self, ring: &[Crossing], kept: &mut [Kept], mut debt: f64) {
        let count = kept.len();
        for number in (1..count).rev().take(MAX_BALANCED) {
            let [one, this, other] = [number - 1, number, (number + 1) % count].map(|number| kept[number]);
            let crossing = &ring[this.crossing as usize];
            let [before, after] = [one, other].map(|end| self.point(&ring[end.crossing as usize], end.at));
            let end = if other.crossing == 0 { ring.len() } else { other.crossing as usize };
            let forth = self.gate(ring, before, one.crossing as usize + 1..this.crossing as usize);
            let back = self.gate(ring, after, (this.crossing as usize + 1..end).rev());
            let (Some(forth), Some(back)) = (forth, back) else { continue };
            let ranges = [self.range(crossing, before, forth), self.range(crossing, after, back)];
            let [Some(from_before), Some(from_after)] = ranges else { continue };
            let gain = cross(self.unit(crossing.along), minus(after, before));
            let wanted = f64::from(this.at) + debt / gain;
            let at = from_after.nearest(f64::from(from_before.nearest(wanted, this.at)), this.at);
            let is_beyond = self.is_beyond(crossing, at, before, forth) && self.is_beyond(crossing, at, after, back);
            if from_before.contains(at) && is_beyond {
                debt -= gain * (f64::from(at) - f64::from(this.at));
                kept[number].at = at;
            }
        }
    }

    /// The gate of these edges; `None` outside if no line passes them, inside if there are none.
    fn gate(&self, ring: &[Crossing], origin: Vector, edges: impl Iterator<Item = usize>) -> Option<Option<Gate>> {
        let mut gate = None;
        for edge in edges {
            gate = Some(self.pass(&ring[edge], origin, gate)?);
        }
        Some(gate)
    }

    /// The gate of an edge and of those before it; `None` if no line passes all of them.
    ///
    /// All edges lie in front: each is in a cell on the far side of the one before, and no line that passes that one turns back.
    fn pass(&self, crossing: &Crossing, origin: Vector, before: Option<Gate>) -> Option<Gate> {
        let whole = Range { low: f64::from(EDGE), high: PITCH - f64::from(EDGE) };
        let [right, left] = self.seen(crossing, origin, whole);
        let mut gate = Gate { right: right.0, left: left.0, farthest2: 0.0 };
        if let Some(before) = before {
            if cross(before.left, gate.right) > 0.0 || cross(before.right, gate.left) < 0.0 {
                return None;
            }
            if cross(before.left, gate.left) > 0.0 {
                gate.left = before.left;
            }
            if cross(before.right, gate.right) < 0.0 {
                gate.right = before.right;
            }
            gate.farthest2 = before.farthest2;
        }
        gate.near(minus(self.point(crossing, crossing.at), origin), self.tolerance_um)
    }

    /// Where a segment through a gate may end on an edge.
    fn range(&self, crossing: &Crossing, origin: Vector, gate: Option<Gate>) -> Option<Range> {
        let slide = self.tolerance_um / self.pixel_um[crossing.along as usize] * PITCH;
        let at = f64::from(crossing.at);
        let most = Range { low: (at - slide).max(f64::from(EDGE)), high: (at + slide).min(PITCH - f64::from(EDGE)) };
        let Some(gate) = gate else { return Some(most) };
        let [right, left] = self.seen(crossing, origin, most);
        // Where the edge meets a limit of the gate. On the edge the cross product is linear.
        let cut = |limit: Vector| {
            let [one, other] = [right, left].map(|(end, _)| cross(limit, end));
            right.1 + one / (one - other) * (left.1 - right.1)
        };
        if cross(gate.left, right.0) > 0.0 || cross(gate.right, left.0) < 0.0 {
            return None;
        }
        let leftmost = if cross(gate.left, left.0) > 0.0 { cut(gate.left) } else { left.1 };
        let rightmost = if cross(gate.right, right.0) < 0.0 { cut(gate.right) } else { right.1 };
        Some(Range { low: leftmost.min(rightmost), high: leftmost.max(rightmost) })
    }

    /// The ends of a range, with the right one first as seen from a point, and where they are seen.
    fn seen(&self, crossing: &Crossing, origin: Vector, range: Range) -> [(Vector, f64); 2] {
        let [low, high] = [range.low, range.high].map(|at| (minus(self.point_at(crossing, at), origin), at));
        if cross(low.0, high.0) > 0.0 { [low, high] } else { [high, low] }
    }

    /// Whether a segment to a place on an edge ends beyond all points that it passes.
    fn is_beyond(&self, crossing: &Crossing, at: u16, origin: Vector, gate: Option<Gate>) -> bool {
        let end = minus(self.point(crossing, at), origin);
        gate.is_none_or(|gate| dot(end, end) >= gate.farthest2)
    }

    fn point(&self, crossing: &Crossing, at: u16) -> Vector {
        self.point_at(crossing, f64::from(at))
    }

    /// A point of an edge, micrometres, as if neither axis were mirrored.
    fn point_at(&self, crossing: &Crossing, at: f64) -> Vector {
        let mut column_row = [f64::from(crossing.x), f64::from(crossing.y)];
        column_row[crossing.along as usize] += at / PITCH;
        [column_row[0] * self.pixel_um[0], column_row[1] * self.pixel_um[1]]
    }

    /// A step of one unit of [`Crossing::at`], micrometres.
    fn unit(&self, along: Along) -> Vector {
        match along {
            Along::Row => [self.pixel_um[0] / PITCH, 0.0],
            Along::Column => [0.0, self.pixel_um[1] / PITCH],
        }
    }
}

impl Gate {
    /// The directions that also pass `point` within a distance; `None` if there are none.
    fn near(self, point: Vector, distance: f64) -> Option<Self> {
        let Self { mut right, mut left, farthest2 } = self;
        let away2 = dot(point, point);
        let farthest2 = farthest2.max(away2);
        let tangent2 = away2 - distance * distance;
        if tangent2 <= 0.0 {
            return Some(Self { farthest2, ..self });
        }
        // The tangents of the circle around the point.
        let ([x, y], along) = (point, tangent2.sqrt());
        let (to_left, to_right) = (
            [x * along - y * distance, y * along + x * distance],
            [x * along + y * distance, y * along - x * distance],
        );
        // The point may lie to one side of all directions, perhaps behind.
        let is_left = cross(left, point) > 0.0 && (dot(left, point) <= 0.0 || cross(left, to_right) > 0.0);
        let is_right = cross(right, point) < 0.0 && (dot(right, point) <= 0.0 || cross(right, to_left) < 0.0);
        if is_left || is_right {
            return None;
        }
        if cross(left, to_left) < 0.0 {
            left = to_left;
        }
        if cross(right, to_right) > 0.0 {
            right = to_right;
        }
        (cross(right, left) >= 0.0).then_some(Self { right, left, farthest2 })
    }
}

impl Range {
    /// Whether a place on the edge lies in it. Half a unit is rounding, far below [`EDGE`].
    fn contains(&self, at: u16) -> bool {
        (self.low - 0.5..=self.high + 0.5).contains(&f64::from(at))
    }

    /// The place in it that is nearest to one on the edge, or to `usual` if that is not a number.
    fn nearest(&self, at: f64, usual: u16) -> u16 {
        let at = if at.is_finite() { at } else { f64::from(usual) };
        at.max(self.low).min(self.high).round() as u16
    }
}

fn minus(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross(a: Vector, b: Vector) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}
