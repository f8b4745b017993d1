//! What a region is marked with, before it is put in order. `layer_plan` makes it for each region, `fill` collects it, and `pen` writes it.

use crate::layer::{HatchFrame, HatchLine, MarkClass};

use super::hatch::{Hatcher, Hatches};
use super::order::Way;
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
    /// Number of ways through all pieces.
    way_count: usize,
}

/// Memory of this many pieces, points and hatches, bytes. Vectors take as much.
pub(super) fn bytes([pieces, points, lines]: [usize; 3]) -> u64 {
    (pieces * size_of::<Piece>() + points * size_of::<[i32; 2]>() + lines * size_of::<HatchLine>()) as u64
}

/// A piece; [`Pieces`] has its points or hatches.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    pub(super) class: MarkClass,
    pub(super) kind: Kind,
    /// Where it begins in `points`, or in `lines`.
    begin: usize,
    count: usize,
}

/// What a piece consists of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Connected points, or one point. A ring repeats its first.
    Path,
    /// Hatches of a frame, by its number in the layer.
    Part { frame: u8, goes_both_ways: bool },
}

impl Piece {
    /// Whether it can be marked backwards.
    pub(super) fn turns(&self) -> bool {
        match self.kind {
            Kind::Path => true,
            Kind::Part { goes_both_ways, .. } => goes_both_ways,
        }
    }

    /// Number of its points and of its hatches.
    pub(super) fn counts(&self) -> [usize; 2] {
        if self.kind == Kind::Path { [self.count, 0] } else { [0, self.count] }
    }
}

impl Pieces {
    /// The pieces, in the order in which they were added.
    pub(super) fn all(&self) -> &[Piece] {
        &self.pieces
    }

    /// A piece, by its number.
    pub(super) fn piece(&self, number: u32) -> &Piece {
        &self.pieces[number as usize]
    }

    /// Number of ways through all pieces.
    pub(super) fn way_count(&self) -> usize {
        self.way_count
    }

    /// Memory, bytes.
    pub(super) fn memory_bytes(&self) -> u64 {
        bytes([self.pieces.capacity(), self.points.capacity(), self.lines.capacity()])
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

    /// Adds hatches. `frame` is the number of the hatcher's first frame in the layer.
    pub(super) fn push_hatches(&mut self, class: MarkClass, (hatcher, frame): (&Hatcher, u8), hatches: &Hatches) {
        let mut begin = self.lines.len();
        self.reserve([hatches.parts.len(), 0, hatches.lines.len()]);
        self.lines.extend_from_slice(&hatches.lines);
        for part in &hatches.parts {
            let kind = Kind::Part { frame: frame + u8::from(part.turned), goes_both_ways: hatcher.goes_both_ways() };
            self.end(class, kind, begin, begin + part.count as usize);
            begin += part.count as usize;
        }
    }

    fn end(&mut self, class: MarkClass, kind: Kind, begin: usize, end: usize) {
        if begin < end {
            let piece = Piece { class, kind, begin, count: end - begin };
            self.way_count += self.ways_of(&piece);
            self.pieces.push(piece);
        }
    }

    /// Number of pieces, of points of paths, and of hatches.
    pub(super) fn sizes(&self) -> [usize; 3] {
        [self.pieces.len(), self.points.len(), self.lines.len()]
    }

    /// Makes room for as many more, so that adding them does not take more memory than they need.
    pub(super) fn reserve(&mut self, [pieces, points, lines]: [usize; 3]) {
        self.pieces.reserve_exact(pieces);
        self.points.reserve_exact(points);
        self.lines.reserve_exact(lines);
    }

    /// Adds those of another region behind the others.
    pub(super) fn append(&mut self, other: &Self) {
        let (points, lines) = (self.points.len(), self.lines.len());
        self.way_count += other.way_count;
        self.points.extend_from_slice(&other.points);
        self.lines.extend_from_slice(&other.lines);
        self.pieces.extend(other.pieces.iter().map(|piece| {
            let shift = if piece.kind == Kind::Path { points } else { lines };
            Piece { begin: piece.begin + shift, ..*piece }
        }));
    }

    /// The points of a path.
    pub(super) fn path(&self, piece: &Piece) -> &[[i32; 2]] {
        &self.points[piece.begin..piece.begin + piece.count]
    }

    /// The hatches of a part, as they were found.
    pub(super) fn hatches(&self, piece: &Piece) -> &[HatchLine] {
        &self.lines[piece.begin..piece.begin + piece.count]
    }

    /// Number of ways to mark a piece.
    pub(super) fn ways_of(&self, piece: &Piece) -> usize {
        match piece.kind {
            Kind::Path => match ring(self.path(piece)) {
                Some(ring) => ring.len().div_ceil(ring_step(ring)),
                None => 2,
            },
            Kind::Part { goes_both_ways: true, .. } => 4,
            Kind::Part { goes_both_ways: false, .. } => 2.min(piece.count),
        }
    }

    /// The ways to mark a piece. See [`Stops::push`](super::order::Stops::push).
    pub(super) fn ways(&self, piece: &Piece, frames: &[HatchFrame]) -> Vec<Way> {
        let Kind::Part { frame, goes_both_ways } = piece.kind else {
            let points = self.path(piece);
            let [first, last] = [points[0], points[points.len() - 1]];
            return match ring(points) {
                Some(ring) => ring.iter().step_by(ring_step(ring)).map(|point| [*point; 2]).collect(),
                None => vec![[first, last], [last, first]],
            };
        };
        let lines = self.hatches(piece);
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

    /// Where a piece is entered by its first way.
    pub(super) fn place(&self, piece: &Piece, frames: &[HatchFrame]) -> [i32; 2] {
        match piece.kind {
            Kind::Path => self.path(piece)[0],
            Kind::Part { frame, .. } => {
                let HatchLine { line, from_um, .. } = self.hatches(piece)[0];
                frames[usize::from(frame)].point_um(line, from_um)
            }
        }
    }
}

/// The points of a path that is a ring, each once; `None` if it is a line or a point.
pub(super) fn ring(path: &[[i32; 2]]) -> Option<&[[i32; 2]]> {
    (path.len() > 1 && path.first() == path.last()).then(|| &path[1..])
}

/// Every how many points of a ring it may be begun.
fn ring_step(ring: &[[i32; 2]]) -> usize {
    ring.len().div_ceil(MAX_RING_STARTS)
}
