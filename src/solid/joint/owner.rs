//! Bits of joined materials, eight pixels at a time: which pixels are solid, and which material each of them gets. Every pixel gets exactly one.
//! `tests/exact/joined.rs` compares them with the formulas.

use super::halftone::Halftone;
use super::{JoinedShape, Joining, MAX_MATERIALS};
use crate::solid::InstructionSet;
use crate::solid::instruction_set::Work;
use crate::solid::pixels::sign_bits;

/// Pixels of a byte of bits.
pub(super) const PIXELS: usize = 8;

/// How a material is chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Rule {
    /// Material i where `Σ_{j<i} Vⱼ ≤ τ < Σ_{j≤i} Vⱼ`, with the threshold τ of the pixel and V the weights divided by their sum.
    Threshold(Halftone),
    /// The one with the greatest weight; of equal ones the first.
    Max,
}

/// A stretch of a row of joined materials.
pub(crate) struct Stretch<'a, S: JoinedShape> {
    pub(crate) joining: &'a Joining,
    /// The cells of each material; a whole number of eights.
    pub(crate) cells: &'a [&'a [S::Cell]],
    /// Column and row of the first pixel; the column is a multiple of 8.
    pub(crate) place: [usize; 2],
}

impl<S: JoinedShape> Stretch<'_, S> {
    /// Sets the bits of solid pixels; other bits stay. The first pixel of a byte is its highest bit.
    pub(crate) fn merge_bits(self, instructions: InstructionSet, out: &mut [u8]) {
        instructions.run(Solid { stretch: self, out });
    }

    /// Sets the bit of each solid pixel for its material: of material m in `out[m]`, whose bits are clear.
    pub(crate) fn divide_bits(self, instructions: InstructionSet, rule: Rule, out: &mut [&mut [u8]]) {
        instructions.run(Divided::<_, _> { stretch: self, rule, is_drawn: NoGrey, out });
    }

    /// Gives each pixel that `drawn` has lit to its material: bits of material m in `out[m]`, which are clear.
    pub(crate) fn divide_grey(self, instructions: InstructionSet, rule: Rule, drawn: &[u8], out: &mut [&mut [u8]]) {
        instructions.run(Divided { stretch: self, rule, is_drawn: Grey(drawn), out });
    }
}

struct Solid<'a, S: JoinedShape> {
    stretch: Stretch<'a, S>,
    out: &'a mut [u8],
}

impl<S: JoinedShape> Work for Solid<'_, S> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Stretch { joining, cells, .. } = self.stretch;
        for (byte, out) in self.out.iter_mut().enumerate() {
            *out |= S::solid(joining, cells, byte * PIXELS);
        }
    }
}

/// Which of eight pixels are lit.
trait Drawn {
    fn bits<S: JoinedShape>(&self, joining: &Joining, cells: &[&[S::Cell]], first: usize) -> u8;
}

/// Those that are solid.
struct NoGrey;

impl Drawn for NoGrey {
    #[inline(always)]
    fn bits<S: JoinedShape>(&self, joining: &Joining, cells: &[&[S::Cell]], first: usize) -> u8 {
        S::solid(joining, cells, first)
    }
}

/// Those that have a grey value.
struct Grey<'a>(&'a [u8]);

impl Drawn for Grey<'_> {
    #[inline(always)]
    fn bits<S: JoinedShape>(&self, _: &Joining, _: &[&[S::Cell]], first: usize) -> u8 {
        let rest = &self.0[first.min(self.0.len())..];
        let Some(eight) = rest.first_chunk::<PIXELS>() else {
            return rest.iter().enumerate().fold(0, |bits, (pixel, grey)| bits | u8::from(*grey > 0) << (7 - pixel));
        };
        // The high bit of each byte that is not 0, then all of them in one byte, the first pixel's as the highest.
        let grey = u64::from_le_bytes(*eight);
        let lit = (grey & 0x7f7f_7f7f_7f7f_7f7f).wrapping_add(0x7f7f_7f7f_7f7f_7f7f) | grey;
        ((lit >> 7 & 0x0101_0101_0101_0101).wrapping_mul(0x8040_2010_0804_0201) >> 56) as u8
    }
}

struct Divided<'a, 'b, S: JoinedShape, D> {
    stretch: Stretch<'a, S>,
    rule: Rule,
    is_drawn: D,
    out: &'a mut [&'b mut [u8]],
}

impl<S: JoinedShape, D: Drawn> Work for Divided<'_, '_, S, D> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Stretch { joining, cells, place: [column, row] } = self.stretch;
        let thresholds = match self.rule {
            Rule::Threshold(halftone) => Some(halftone.row(row)),
            Rule::Max => None,
        };
        let mut weights = [[0.0; PIXELS]; MAX_MATERIALS];
        let weights = &mut weights[..cells.len()];
        for byte in 0..self.out.first().map_or(0, |out| out.len()) {
            let first = byte * PIXELS;
            let drawn = self.is_drawn.bits::<S>(joining, cells, first);
            // Most of a picture is dark.
            if drawn == 0 {
                continue;
            }
            S::weigh(cells, first, weights);
            let owners = match &thresholds {
                Some(thresholds) => {
                    let phase = (column + first) % Halftone::PERIOD;
                    let Some(eight) = thresholds[phase..].first_chunk() else { continue };
                    by_threshold(weights, eight)
                }
                None => greatest(weights),
            };
            for (out, owner) in self.out.iter_mut().zip(owners) {
                out[byte] = owner & drawn;
            }
        }
    }
}

#[inline(always)]
fn by_threshold(weights: &[[f32; PIXELS]], thresholds: &[f32; PIXELS]) -> [u8; MAX_MATERIALS] {
    let mut sum = [0.0; PIXELS];
    for weights in weights {
        for lane in 0..PIXELS {
            sum[lane] += weights[lane];
        }
    }
    let mut owners = [0; MAX_MATERIALS];
    let (mut before, mut free) = ([0.0; PIXELS], 0xff);
    let Some((_, all_but_last)) = weights.split_last() else { return owners };
    for (owner, weights) in owners.iter_mut().zip(all_but_last) {
        let mut below = [0.0; PIXELS];
        for lane in 0..PIXELS {
            before[lane] += weights[lane];
            below[lane] = thresholds[lane] * sum[lane] - before[lane];
        }
        // Negative where the threshold is below what the materials so far have.
        let bits = sign_bits(&below);
        *owner = bits & free;
        free &= !bits;
    }
    // The last one gets all that is left, whatever was rounded.
    owners[all_but_last.len()] = free;
    owners
}

#[inline(always)]
fn greatest(weights: &[[f32; PIXELS]]) -> [u8; MAX_MATERIALS] {
    let mut owners = [0; MAX_MATERIALS];
    let Some((first, others)) = weights.split_first() else { return owners };
    let mut most = *first;
    owners[0] = 0xff;
    for (material, weights) in others.iter().enumerate() {
        let mut less = [0.0; PIXELS];
        for lane in 0..PIXELS {
            less[lane] = most[lane] - weights[lane];
            most[lane] = if weights[lane] > most[lane] { weights[lane] } else { most[lane] };
        }
        let bits = sign_bits(&less);
        owners.iter_mut().for_each(|owner| *owner &= !bits);
        owners[material + 1] = bits;
    }
    owners
}
