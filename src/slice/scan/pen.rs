//! Writes pieces in a short order, and counts jumps and marks. `fill` hands it the pieces of neighbouring regions.
//!
//! The tables of the order take memory for each way through a piece. More pieces than [`MAX_ORDERED`] allows are divided by place, like the
//! boxes of a map, and box after box is put in order. So only the jumps between two boxes are longer than they need to be.

use std::time::{Duration, Instant};

use crate::layer::{HatchFrame, HatchLine, Vectors};
use crate::slice::SliceError;
use crate::stream::{BudgetExceeded, MemoryBudget};

use super::counts::ScanCounts;
use super::fill::FillError;
use super::order::{Stops, Visit, distance_um};
use super::pieces::{self, Kind, Piece, Pieces, ring};

/// Most that is put in order at once: the number of ways, and two for each piece. The tables then take 4 MiB, while a layer of a real
/// lattice, with some 600 islands, is put in order as a whole.
pub(super) const MAX_ORDERED: usize = 1 << 16;

/// Memory of the tables for each way, and for half a piece, bytes: three lists of ways and of points, and nested boxes.
const ORDER_BYTES: u64 = 64;

/// The laser on its way through a layer.
pub(super) struct Pen<'a> {
    layer: u32,
    frames: &'a [HatchFrame],
    budget: &'a MemoryBudget,
    /// Where it is; `None` before the first piece.
    at: Option<[i32; 2]>,
    /// Where it would be if pieces were marked in the order in which they were found.
    found_at: Option<[i32; 2]>,
    /// Time that the order took.
    pub(super) time: Duration,
}

/// What a piece adds to the tables of the order: see [`MAX_ORDERED`].
pub(super) fn weight(ways: usize, pieces: usize) -> usize {
    ways + 2 * pieces
}

impl<'a> Pen<'a> {
    /// At the start of a layer with these frames.
    pub(super) fn new(layer: u32, frames: &'a [HatchFrame], budget: &'a MemoryBudget) -> Self {
        Self { layer, frames, budget, at: None, found_at: None, time: Duration::ZERO }
    }

    /// Writes all pieces, hands their vectors on in one or more groups, and counts jumps and marks.
    ///
    /// # Errors
    /// That of `take`, or [`FillError::Slice`] if the budget has no room for the tables of the order.
    pub(super) fn write<E: From<FillError>>(
        &mut self,
        pieces: &Pieces,
        counts: &mut ScanCounts,
        take: &mut impl FnMut(&Vectors) -> Result<(), E>,
    ) -> Result<(), E> {
        let count = pieces.all().len();
        let _numbers =
            self.budget.charge("the pieces of a layer", 4 * count as u64).map_err(|few| self.too_complex(few))?;
        let mut numbers: Vec<u32> = (0..count as u32).collect();
        self.write_box(pieces, &mut numbers, counts, take)
    }

    fn too_complex(&self, exceeded: BudgetExceeded) -> FillError {
        SliceError::TooComplex { layer: self.layer, exceeded }.into()
    }

    fn write_box<E: From<FillError>>(
        &mut self,
        pieces: &Pieces,
        numbers: &mut [u32],
        counts: &mut ScanCounts,
        take: &mut impl FnMut(&Vectors) -> Result<(), E>,
    ) -> Result<(), E> {
        let began = Instant::now();
        let way_count = numbers.iter().map(|number| pieces.ways_of(pieces.piece(*number))).sum();
        if weight(way_count, numbers.len()) > MAX_ORDERED && numbers.len() > 1 {
            let halves = self.halves(pieces, numbers);
            self.time += began.elapsed();
            for half in halves {
                self.write_box(pieces, half, counts, take)?;
            }
            return Ok(());
        }
        let size = BoxSize::of(pieces, numbers);
        let bytes = ORDER_BYTES * weight(way_count, numbers.len()) as u64 + size.bytes();
        let _charge = self.budget.charge("putting vectors in order", bytes).map_err(|few| self.too_complex(few))?;
        // As they were found.
        numbers.sort_unstable();
        let mut stops = Stops::with_capacity(numbers.len(), way_count);
        for number in &*numbers {
            let piece = pieces.piece(*number);
            let ways = pieces.ways(piece, self.frames);
            if let Some([from, to]) = ways.first() {
                counts.unordered_jump_um += self.found_at.map_or(0.0, |at| distance_um(at, *from));
                self.found_at = Some(*to);
            }
            stops.push(ways, piece.turns());
        }
        let visits = stops.ordered(self.at);
        let after_um = stops.jump_um(self.at, &visits);
        let before = self.at;
        let vectors = self.write_visits((pieces, numbers), &visits, &stops, &size);
        let (jump_um, mark_um) = lengths_um(&vectors, before);
        counts.jump_um += jump_um;
        counts.mark_um += mark_um;
        // Within pieces the jumps are the same.
        counts.unordered_jump_um += jump_um - after_um;
        self.time += began.elapsed();
        drop(stops);
        take(&vectors)
    }

    /// Divides pieces by place, across the longer side of the box around them.
    fn halves<'n>(&self, pieces: &Pieces, numbers: &'n mut [u32]) -> [&'n mut [u32]; 2] {
        let place = |number: &u32| pieces.place(pieces.piece(*number), self.frames);
        let end =
            |axis: usize, pick: fn(i32, i32) -> i32| numbers.iter().map(|number| place(number)[axis]).reduce(pick);
        let side =
            |axis| end(axis, i32::max).zip(end(axis, i32::min)).map(|(high, low)| i64::from(high) - i64::from(low));
        let axis = usize::from(side(1) > side(0));
        let middle = numbers.len() / 2;
        numbers.select_nth_unstable_by_key(middle, |number| (place(number)[axis], *number));
        let (low, high) = numbers.split_at_mut(middle);
        [low, high]
    }

    fn write_visits(
        &mut self,
        (pieces, numbers): (&Pieces, &[u32]),
        visits: &[Visit],
        stops: &Stops,
        size: &BoxSize,
    ) -> Vectors {
        let mut vectors = Vectors::default();
        vectors.reserve(size.all);
        let [most_points, most_hatches] = size.largest;
        let (mut path, mut hatches) = (Vec::with_capacity(most_points), Vec::with_capacity(most_hatches));
        for (number, visit) in visits.iter().enumerate() {
            let piece = pieces.piece(numbers[visit.stop as usize]);
            let Kind::Part { frame, .. } = piece.kind else {
                let next = visits.get(number + 1).map(|next| stops.way(*next)[0]);
                path.clear();
                lay_path(pieces.path(piece), visit.way, [self.at, next], &mut path);
                vectors.push_path(piece.class, &path);
                self.at = path.last().copied();
                continue;
            };
            hatches.clear();
            lay_part(pieces.hatches(piece), piece, visit.way, &mut hatches);
            vectors.push_hatches(piece.class, self.frames[usize::from(frame)], &hatches);
            self.at = Some(stops.way(*visit)[1]);
        }
        vectors
    }
}

/// How much is put in order at once.
struct BoxSize {
    /// Number of pieces, points and hatches.
    all: [usize; 3],
    /// The most points and hatches of a piece.
    largest: [usize; 2],
}

impl BoxSize {
    fn of(pieces: &Pieces, numbers: &[u32]) -> Self {
        let mut size = Self { all: [numbers.len(), 0, 0], largest: [0; 2] };
        for [points, hatches] in numbers.iter().map(|number| pieces.piece(*number).counts()) {
            size.all = [size.all[0], size.all[1] + points, size.all[2] + hatches];
            size.largest = [size.largest[0].max(points), size.largest[1].max(hatches)];
        }
        size
    }

    /// Memory of the vectors, and of the piece that is being written, bytes.
    fn bytes(&self) -> u64 {
        let [points, hatches] = self.largest;
        pieces::bytes(self.all) + pieces::bytes([0, points, hatches])
    }
}

/// A path from where it is entered. A ring begins where that costs least between the laser's place and the next stop's.
fn lay_path(points: &[[i32; 2]], way: u32, near: [Option<[i32; 2]>; 2], path: &mut Vec<[i32; 2]>) {
    let Some(ring) = ring(points) else {
        path.extend_from_slice(points);
        if way == 1 {
            path.reverse();
        }
        return;
    };
    let cost = |point: [i32; 2]| near.iter().flatten().map(|other| distance_um(*other, point)).sum::<f64>();
    let best = (0..ring.len()).min_by(|a, b| cost(ring[*a]).total_cmp(&cost(ring[*b]))).unwrap_or(0);
    path.extend_from_slice(&ring[best..]);
    path.extend_from_slice(&ring[..=best]);
}

/// The hatches of a part, in the order and the direction of a way.
fn lay_part(found: &[HatchLine], piece: &Piece, way: u32, hatches: &mut Vec<HatchLine>) {
    hatches.extend_from_slice(found);
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

/// Length of the jumps and of the marks, micrometres. `at` is where the laser is before, if that is known.
fn lengths_um(vectors: &Vectors, mut at: Option<[i32; 2]>) -> (f64, f64) {
    let (mut jump_um, mut mark_um) = (0.0, 0.0);
    for mark in vectors.marks() {
        jump_um += at.map_or(0.0, |at| distance_um(at, mark.from_um));
        mark_um += distance_um(mark.from_um, mark.to_um);
        at = Some(mark.to_um);
    }
    (jump_um, mark_um)
}
