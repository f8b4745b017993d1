//! What a region is marked with, before it is put in order. `layer_plan` makes it for each region, `fill` collects it.

use crate::layer::{HatchFrame, HatchLine, MarkClass, Vectors};

use super::counts::ScanCounts;
use super::hatch::{Ground, Hatcher, Part};
use super::order::{Stops, Visit, Way, distance_um};
use super::path::simplify;

/// At how many points of a ring the order may begin it while it is searched for, so that the work for a ring is bounded. In the end
/// each of its points is tried.
const MAX_RING_STARTS: usize = 16;

/// Tolerance for leaving out points of rings, micrometres. Rounding to whole micrometres moves points as far.
const RING_TOLERANCE_UM: f64 = 0.7;

/// Pieces that are marked without a choice in between.
#[derive(Debug, Default)]
pub(super) struct Pieces {
    pieces: Vec<Piece>,
    points: Vec<[i32; 2]>,
    lines: Vec<HatchLine>,
}

#[derive(Clone, Copy, Debug)]
struct Piece {
    class: MarkClass,
    kind: Kind,
    /// Where it begins in `points`, or in `lines`.
    begin: usize,
    count: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Connected points, or one point. A ring repeats its first.
    Path,
    /// Hatches of a frame, by its number in the layer.
    Part { frame: u8, goes_both_ways: bool },
}

impl Piece {
    /// Whether it can be marked backwards.
    fn turns(&self) -> bool {
        match self.kind {
            Kind::Path => true,
            Kind::Part { goes_both_ways, .. } => goes_both_ways,
        }
    }
}

impl Pieces {
    /// Number of pieces.
    pub(super) fn len(&self) -> usize {
        self.pieces.len()
    }

    /// Adds a path, rounded to whole micrometres. What rounds to a single point is a timed point.
    pub(super) fn push_path(&mut self, class: MarkClass, points_um: &[[f64; 2]]) {
        let begin = self.points.len();
        for point in points_um {
            let point = point.map(|um| um.round() as i32);
            if self.points[begin..].last() != Some(&point) {
                self.points.push(point);
            }
        }
        let is_point = self.points.len() - begin == 1;
        self.end(if is_point { MarkClass::Point } else { class }, Kind::Path, begin, self.points.len());
    }

    /// Adds a ring that does not repeat its first point.
    pub(super) fn push_ring(&mut self, class: MarkClass, mut ring_um: Vec<[f64; 2]>) {
        ring_um.extend(ring_um.first().copied());
        simplify(&mut ring_um, RING_TOLERANCE_UM);
        self.push_path(class, &ring_um);
    }

    /// Adds the hatches of some ground. `frame` is the number of the hatcher's first frame in the layer.
    pub(super) fn push_hatches(
        &mut self,
        class: MarkClass,
        (hatcher, frame): (&Hatcher, u8),
        ground: &Ground<'_>,
        counts: &mut ScanCounts,
    ) {
        let mut begin = self.lines.len();
        let mut parts: Vec<Part> = Vec::new();
        hatcher.fill(ground, &mut self.lines, &mut parts, counts);
        for part in parts {
            let kind = Kind::Part { frame: frame + u8::from(part.turned), goes_both_ways: hatcher.goes_both_ways() };
            self.end(class, kind, begin, begin + part.count);
            begin += part.count;
        }
    }

    fn end(&mut self, class: MarkClass, kind: Kind, begin: usize, end: usize) {
        if begin < end {
            self.pieces.push(Piece { class, kind, begin, count: end - begin });
        }
    }

    /// Adds those of another region behind the others.
    pub(super) fn append(&mut self, other: &Self) {
        let (points, lines) = (self.points.len(), self.lines.len());
        self.points.extend_from_slice(&other.points);
        self.lines.extend_from_slice(&other.lines);
        self.pieces.extend(other.pieces.iter().map(|piece| {
            let shift = if piece.kind == Kind::Path { points } else { lines };
            Piece { begin: piece.begin + shift, ..*piece }
        }));
    }

    /// Writes all pieces in a short order, and counts jumps and marks.
    pub(super) fn write(&self, frames: &[HatchFrame], out: &mut Vectors, counts: &mut ScanCounts) {
        let mut stops = Stops::default();
        for piece in &self.pieces {
            stops.push(self.ways(piece, frames), piece.turns());
        }
        let before_um = stops.jump_um(&stops.as_added());
        let visits = stops.ordered();
        let after_um = stops.jump_um(&visits);
        let written = out.mark_count();
        self.write_visits(&visits, &stops, frames, out);
        let (jump_um, mark_um) = lengths_um(out, written);
        counts.jump_um += jump_um;
        counts.mark_um += mark_um;
        // Within pieces the jumps are the same.
        counts.unordered_jump_um += jump_um - after_um + before_um;
    }

    fn path(&self, piece: &Piece) -> &[[i32; 2]] {
        &self.points[piece.begin..piece.begin + piece.count]
    }

    /// The ways to mark a piece. See [`Stops::push`].
    fn ways(&self, piece: &Piece, frames: &[HatchFrame]) -> Vec<Way> {
        let Kind::Part { frame, goes_both_ways } = piece.kind else {
            let points = self.path(piece);
            let [first, last] = [points[0], points[points.len() - 1]];
            if first != last || points.len() == 1 {
                return vec![[first, last], [last, first]];
            }
            let step = (points.len() - 1).div_ceil(MAX_RING_STARTS);
            return points[1..].iter().step_by(step).map(|point| [*point; 2]).collect();
        };
        let lines = &self.lines[piece.begin..piece.begin + piece.count];
        let frame = &frames[usize::from(frame)];
        let (first, last) = (lines[0], lines[lines.len() - 1]);
        let ends = |line: HatchLine| [line.from_um, line.to_um].map(|along_um| frame.point_um(line.line, along_um));
        let ([a, b], [c, d]) = (ends(first), ends(last));
        match (goes_both_ways, lines.len() % 2) {
            // All from low to high, forwards or backwards.
            (false, _) if lines.len() == 1 => vec![[a, b]],
            (false, _) => vec![[a, d], [c, b]],
            // Beginning at the low or the high end of the first line, each with its reverse.
            (true, 1) => vec![[a, d], [d, a], [b, c], [c, b]],
            (true, _) => vec![[a, c], [c, a], [b, d], [d, b]],
        }
    }

    fn write_visits(&self, visits: &[Visit], stops: &Stops, frames: &[HatchFrame], out: &mut Vectors) {
        let mut at = None;
        let mut path = Vec::new();
        let mut hatches = Vec::new();
        for (number, visit) in visits.iter().enumerate() {
            let piece = &self.pieces[visit.stop as usize];
            let Kind::Part { frame, .. } = piece.kind else {
                let next = visits.get(number + 1).map(|next| stops.way(*next)[0]);
                path.clear();
                self.lay_path(piece, visit.way, at, next, &mut path);
                out.push_path(piece.class, &path);
                at = path.last().copied();
                continue;
            };
            hatches.clear();
            self.lay_part(piece, visit.way, &mut hatches);
            out.push_hatches(piece.class, frames[usize::from(frame)], &hatches);
            at = Some(stops.way(*visit)[1]);
        }
    }

    /// A path from where it is entered. A ring begins where that costs least between the laser's place and the next stop's.
    fn lay_path(
        &self,
        piece: &Piece,
        way: u32,
        at: Option<[i32; 2]>,
        next: Option<[i32; 2]>,
        path: &mut Vec<[i32; 2]>,
    ) {
        let points = self.path(piece);
        let [first, last] = [points[0], points[points.len() - 1]];
        if first != last || points.len() == 1 {
            path.extend_from_slice(points);
            if way == 1 {
                path.reverse();
            }
            return;
        }
        let ring = &points[1..];
        let far = |from: [i32; 2], to: Option<[i32; 2]>| to.map_or(0.0, |to| distance_um(from, to));
        let cost = |point: [i32; 2]| far(point, at) + far(point, next);
        let best = (0..ring.len()).min_by(|a, b| cost(ring[*a]).total_cmp(&cost(ring[*b]))).unwrap_or(0);
        path.extend_from_slice(&ring[best..]);
        path.extend_from_slice(&ring[..=best]);
    }

    /// The hatches of a part, in the order and the direction of a way.
    fn lay_part(&self, piece: &Piece, way: u32, hatches: &mut Vec<HatchLine>) {
        hatches.extend_from_slice(&self.lines[piece.begin..piece.begin + piece.count]);
        let flip = |line: &mut HatchLine| std::mem::swap(&mut line.from_um, &mut line.to_um);
        if piece.turns() {
            // Ways 2 and 3 begin at the high end of the first line.
            hatches.iter_mut().skip(usize::from(way < 2)).step_by(2).for_each(flip);
            if way % 2 == 1 {
                hatches.reverse();
                hatches.iter_mut().for_each(flip);
            }
        } else if way == 1 {
            hatches.reverse();
        }
    }
}

/// Length of the jumps and of the marks from a vector on, micrometres.
fn lengths_um(vectors: &Vectors, first: u64) -> (f64, f64) {
    let mut at = None;
    let (mut jump_um, mut mark_um) = (0.0, 0.0);
    for mark in vectors.marks().skip(usize::try_from(first).unwrap_or(usize::MAX)) {
        jump_um += at.map_or(0.0, |at| distance_um(at, mark.from_um));
        mark_um += distance_um(mark.from_um, mark.to_um);
        at = Some(mark.to_um);
    }
    (jump_um, mark_um)
}
