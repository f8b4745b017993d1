//! Joins convolution fields. `tests/exact/joined.rs` compares every pixel with the formulas.
//!
//! Elliptic arcs: the joined field G is the root of `Σ max(fᵢ − sᵢ G, 0)²/(1 − sᵢ)² = G²` ([`elliptic`](crate::solid::reference::elliptic)). The left side
//! less the right one falls as G grows. So G is at least the isovalue C exactly where `ρ² = Σ qᵢ² ≥ C²` with `qᵢ = max(fᵢ − sᵢ C, 0)/(1 − sᵢ)`: no root is
//! needed, and no order of the fields. A cell holds `C + (ρ − C) Σ (1 − sᵢ) qᵢ² / ρ²`, which is C on the same surface, C¹, and the field itself where
//! only one takes part.

use super::{FieldOfMaterial, JoinedShape, Joining, MAX_MATERIALS};
use crate::solid::instruction_set::Work;
use crate::solid::pixels::packed;
use crate::solid::vector::{LANES, greater, lesser};
use crate::solid::{Convolution, ISOVALUE, InstructionSet};

impl JoinedShape for Convolution {
    fn join(instructions: InstructionSet, joining: &Joining, cells: &[&[f32]], out: &mut [f32]) {
        match joining {
            Joining::Sum => instructions.run(Sum { fields: cells, out }),
            Joining::Elliptic(least) => instructions.run(Elliptic { fields: cells, least, out }),
        }
    }

    #[inline(always)]
    fn solid(joining: &Joining, cells: &[&[f32]], first: usize) -> u8 {
        let mut sum = [0.0; LANES];
        for cells in cells {
            for (sum, field) in sum.iter_mut().zip(&cells[first..first + LANES]) {
                *sum += field;
            }
        }
        let bits = packed(&sum);
        match joining {
            Joining::Sum => bits,
            // The joined field is at most the sum.
            Joining::Elliptic(_) if bits == 0 => 0,
            Joining::Elliptic(least) => packed(&squares(cells, least, first)),
        }
    }

    #[inline(always)]
    fn weigh(cells: &[&[f32]], first: usize, weights: &mut [[f32; 8]]) {
        for (weights, cells) in weights.iter_mut().zip(cells) {
            weights.copy_from_slice(&cells[first..first + LANES]);
        }
    }
}

impl FieldOfMaterial for Convolution {
    fn restrict(cells: &[&[f32]], only: usize, joined: &mut [f32]) {
        for (pixel, joined) in joined.iter_mut().enumerate() {
            let mut others = 0.0;
            for (_, fields) in cells.iter().enumerate().filter(|(member, _)| *member != only) {
                others = greater(others, fields[pixel]);
            }
            *joined = lesser(*joined, ISOVALUE as f32 + (cells[only][pixel] - others));
        }
    }
}

struct Sum<'a> {
    fields: &'a [&'a [f32]],
    out: &'a mut [f32],
}

impl Work for Sum<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Some((first, others)) = self.fields.split_first() else { return };
        self.out.copy_from_slice(first);
        for field in others {
            for (sum, field) in self.out.iter_mut().zip(*field) {
                *sum += field;
            }
        }
    }
}

struct Elliptic<'a> {
    fields: &'a [&'a [f32]],
    least: &'a [f32; MAX_MATERIALS],
    out: &'a mut [f32],
}

impl Work for Elliptic<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        for (number, out) in self.out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            *out = arcs(self.fields, self.least, number * LANES);
        }
    }
}

/// `ρ²/C` of eight pixels.
#[inline(always)]
fn squares(fields: &[&[f32]], least: &[f32; MAX_MATERIALS], first: usize) -> [f32; LANES] {
    const C: f32 = ISOVALUE as f32;
    let mut squares = [0.0; LANES];
    for (fields, least) in fields.iter().zip(least) {
        let scale = 1.0 / (1.0 - least);
        for (squares, field) in squares.iter_mut().zip(&fields[first..first + LANES]) {
            let q = greater(field - least * C, 0.0) * scale;
            *squares += q * q * (1.0 / C);
        }
    }
    squares
}

/// The joined cells of eight pixels.
#[inline(always)]
fn arcs(fields: &[&[f32]], least: &[f32; MAX_MATERIALS], first: usize) -> [f32; LANES] {
    const C: f32 = ISOVALUE as f32;
    let [mut greatest, mut squares, mut scaled, mut out] = [[0.0; LANES]; 4];
    for (fields, least) in fields.iter().zip(least) {
        let (rest, scale) = (1.0 - least, 1.0 / (1.0 - least));
        let fields = &fields[first..first + LANES];
        for lane in 0..LANES {
            let q = greater(fields[lane] - least * C, 0.0) * scale;
            greatest[lane] = greater(greatest[lane], fields[lane]);
            squares[lane] += q * q;
            scaled[lane] += rest * (q * q);
        }
    }
    for lane in 0..LANES {
        // Where no field takes part, the quotient is not used.
        let joined = C + (squares[lane].sqrt() - C) * (scaled[lane] / squares[lane]);
        out[lane] = if squares[lane] > 0.0 { joined } else { greatest[lane] };
    }
    out
}
