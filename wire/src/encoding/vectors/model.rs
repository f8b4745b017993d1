//! The probability model of `VectorsCoded`: what is known of the numbers of each [`Field`].
//!
//! A number is its lowest bits, which are flags and a sign, and the rest. The rest is coded as its length in bits, the bit below the
//! highest, and the other bits, which are as good as random. Then come the lowest bits. `docs/encodings.md` describes the model in
//! words.

use core::slice;

use super::super::range::{Probability, RangeDecoder, RangeEncoder};
use super::error::VectorError;
use super::symbol::Field;

/// Lengths 0 to 14 have a code of their own. 15 is followed by what is above it.
const LENGTHS: usize = 16;
/// The longest length with a code of its own, plus 1.
const LONG: u32 = LENGTHS as u32 - 1;
/// Number of bits of what is above that.
const LONG_BITS: u32 = 5;
/// Groups of fields that share statistics of the second bit.
const GROUPS: usize = 9;
/// Kinds of the run before a head.
const HEADS: usize = 5;
/// Statistics of lengths: heads by the run before, steps by what is known of them, and one for each other group.
const CONTEXTS: usize = GROUPS - 3 + HEADS + 2 * Field::STEP_SIZES;

/// The adaptive state, the same in encoder and decoder.
#[derive(Clone, Debug)]
pub(super) struct Model {
    /// Length of a number's rest: a binary tree.
    lengths: [[Probability; LENGTHS - 1]; CONTEXTS],
    /// The bit below the highest, by the length.
    seconds: [[Probability; LENGTHS]; GROUPS],
    /// Class and kind of a head: a binary tree.
    heads: [[Probability; 31]; HEADS],
    /// Signs of jumps, along x and y, and of the high end of a hatch.
    signs: [Probability; 3],
    /// Sign and flag of the low end of a hatch, and of a turn.
    flags: [[Probability; 3]; 2],
    step_signs: [Probability; Field::STEP_SIGNS],
}

/// `docs/encodings.md` states this size for firmware.
const _: () = assert!(size_of::<Model>() == 2662);

impl Default for Model {
    fn default() -> Self {
        Self {
            lengths: [[Probability::EVEN; LENGTHS - 1]; CONTEXTS],
            seconds: [[Probability::EVEN; LENGTHS]; GROUPS],
            heads: [[Probability::EVEN; 31]; HEADS],
            signs: [Probability::EVEN; 3],
            flags: [[Probability::EVEN; 3]; 2],
            step_signs: [Probability::EVEN; Field::STEP_SIGNS],
        }
    }
}

impl Model {
    /// The most bytes that a number takes. A head has ten learned bits of at most 11.1 bits each, and 12 even bits. A coordinate has
    /// seven learned bits, and at most 27 even ones.
    pub(super) const STEP_BYTES: u32 = 16;

    /// Writes a number of at most [`longest`] bits besides its lowest ones.
    pub(super) fn put(&mut self, field: Field, number: u32, coder: &mut RangeEncoder<'_>) {
        let low_bits = low_bits(field);
        let rest = number >> low_bits;
        let length = u32::BITS - rest.leading_zeros();
        put_tree(&mut self.lengths[context(field)], length.min(LONG), 4, coder);
        if length >= LONG {
            coder.put_even(length - LONG, LONG_BITS);
        }
        if length > 1 {
            let second = &mut self.seconds[group(field)][length.min(LONG) as usize];
            coder.put(rest >> (length - 2) & 1 == 1, second);
            // A range coder takes at most 16 even bits at once.
            let even_bits = length - 2;
            let high_bits = even_bits.saturating_sub(16);
            let even = rest & ((1 << even_bits) - 1);
            coder.put_even(even >> (even_bits - high_bits), high_bits);
            coder.put_even(even & ((1 << (even_bits - high_bits)) - 1), even_bits - high_bits);
        }
        put_tree(self.lowest(field), number & ((1 << low_bits) - 1), low_bits, coder);
    }

    /// Reads what [`put`](Self::put) wrote.
    pub(super) fn take(&mut self, field: Field, coder: &mut RangeDecoder) -> Result<u32, VectorError> {
        let low_bits = low_bits(field);
        let short = take_tree(&mut self.lengths[context(field)], 4, coder);
        let length = if short < LONG { short } else { LONG + coder.take_even(LONG_BITS) };
        if length > longest(field) {
            return Err(VectorError::BadCode);
        }
        let rest = match length {
            0 | 1 => length,
            _ => {
                let second = &mut self.seconds[group(field)][length.min(LONG) as usize];
                let top = 2 | u32::from(coder.take(second));
                let even_bits = length - 2;
                let high_bits = even_bits.saturating_sub(16);
                let high = top << high_bits | coder.take_even(high_bits);
                let below_bits = even_bits - high_bits;
                high << below_bits | coder.take_even(below_bits)
            }
        };
        Ok(rest << low_bits | take_tree(self.lowest(field), low_bits, coder))
    }

    /// Statistics of a number's lowest bits: a binary tree.
    fn lowest(&mut self, field: Field) -> &mut [Probability] {
        match field {
            Field::Table => &mut [],
            Field::Head { after } => &mut self.heads[usize::from(after)],
            Field::Jump { axis } => slice::from_mut(&mut self.signs[usize::from(axis)]),
            Field::Step { sign, .. } => slice::from_mut(&mut self.step_signs[usize::from(sign)]),
            Field::Low => &mut self.flags[0],
            Field::Turn => &mut self.flags[1],
            Field::High => slice::from_mut(&mut self.signs[2]),
        }
    }
}

/// Number of a number's lowest bits that have statistics of their own.
fn low_bits(field: Field) -> u32 {
    match field {
        Field::Table => 0,
        Field::Head { .. } => 5,
        Field::Jump { .. } | Field::Step { .. } | Field::High => 1,
        Field::Low | Field::Turn => 2,
    }
}

/// The most bits of a number without its lowest ones.
fn longest(field: Field) -> u32 {
    match field {
        Field::Table => 32,
        Field::Head { .. } => 14,
        // The difference of two coordinates, differences or lines, of at most 23 bits.
        Field::Jump { .. } | Field::Step { .. } | Field::Low | Field::Turn | Field::High => 24,
    }
}

fn group(field: Field) -> usize {
    match field {
        Field::Table => 0,
        Field::Jump { axis } => 1 + usize::from(axis),
        Field::Low => 3,
        Field::Turn => 4,
        Field::High => 5,
        Field::Head { .. } => 6,
        Field::Step { axis, .. } => 7 + usize::from(axis),
    }
}

/// Number of the statistics of a number's length.
fn context(field: Field) -> usize {
    match field {
        Field::Head { after } => 6 + usize::from(after),
        Field::Step { axis, size, .. } => 6 + HEADS + usize::from(axis) * Field::STEP_SIZES + usize::from(size),
        other => group(other),
    }
}

/// Writes the lowest `bits` bits of a number, the highest first. The tree's nodes are counted from its root.
fn put_tree(tree: &mut [Probability], number: u32, bits: u32, coder: &mut RangeEncoder<'_>) {
    let mut node = 1;
    for place in (0..bits).rev() {
        let bit = number >> place & 1;
        coder.put(bit == 1, &mut tree[node - 1]);
        node = node * 2 + bit as usize;
    }
}

/// Reads what [`put_tree`] wrote.
fn take_tree(tree: &mut [Probability], bits: u32, coder: &mut RangeDecoder) -> u32 {
    let mut node = 1;
    for _ in 0..bits {
        node = node * 2 + usize::from(coder.take(&mut tree[node - 1]));
    }
    node as u32 - (1 << bits)
}
