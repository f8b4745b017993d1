//! The probability model of RunGrey: predicts a pixel or a run from those before it.
//!
//! A decoder keeps two rows and the [`Model`], which takes 1104 bytes. `docs/encodings.md` describes the model in words.
//! [`run_grey`](super::run_grey) uses it.

use super::range::{Probability, RangeDecoder, RangeEncoder};

/// The known neighbours of the next pixel; 0 outside the picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    left: u8,
    corner: u8,
    up: u8,
    ahead: u8,
}

impl Near {
    /// Around `row[x]`. `above` is empty for the first row.
    pub(super) fn at(row: &[u8], above: &[u8], x: usize) -> Self {
        let at = |row: &[u8], x: usize| row.get(x).copied().unwrap_or(0);
        let [left, corner] = if x == 0 { [0; 2] } else { [at(row, x - 1), at(above, x - 1)] };
        Self { left, corner, up: at(above, x), ahead: at(above, x + 1) }
    }

    /// The colour of all four if they are solid and equal. Most likely the next pixel has it, too.
    pub(super) fn solid(self) -> Option<u8> {
        let Self { left, corner, up, ahead } = self;
        (is_solid(left) && [corner, up, ahead] == [left; 3]).then_some(left)
    }

    /// The context of a pixel, below [`CONTEXTS`].
    fn context(self) -> usize {
        let four = |pixel: u8| three(pixel) + usize::from(pixel > 127);
        ((four(self.left) * 4 + four(self.up)) * 3 + three(self.ahead)) * 3 + three(self.corner)
    }

    fn size_context(self) -> usize {
        three(self.left) * 3 + three(self.up)
    }
}

/// Number of contexts of a pixel.
const CONTEXTS: usize = 4 * 4 * 3 * 3;
/// Number of contexts of the size of a difference.
const SIZE_CONTEXTS: usize = 3 * 3;
/// Differences have up to 7 bits, so sizes are 0 to 7. The binary tree of a size has seven nodes, counted from 1.
const SIZES: usize = 8;
/// Number of contexts of a difference's sign, by the guess: near 0 the sign is mostly positive, near 255 mostly negative.
const SIGN_CONTEXTS: usize = 8;
/// Number of size classes of a zone, which has at most 65535 pixels.
const ZONE_SIZES: usize = 16;
/// Grey pixels are 1 to 254.
const GREYS: i32 = 254;
/// Corrections are kept in sixteenths, which averages over some sixteen pixels of a context.
const CORRECTION_SHIFT: u32 = 4;

/// 0 for dark, 1 for grey, 2 for lit. Without branches, which the processor could not predict.
fn three(pixel: u8) -> usize {
    usize::from(pixel > 0) + usize::from(pixel == 255)
}

pub(super) fn is_solid(pixel: u8) -> bool {
    pixel == 0 || pixel == 255
}

/// The adaptive state, the same in encoder and decoder.
#[derive(Clone, Debug)]
pub(super) struct Model {
    /// Whether a run ends before its zone does, by the zone's size and colour.
    zones: [[Probability; 2]; ZONE_SIZES],
    /// Whether a pixel is grey; if not, whether it is lit.
    kinds: [[Probability; 2]; CONTEXTS],
    /// Sum of the errors of the guesses; a sixteenth of it is added to the next guess.
    corrections: [i16; CONTEXTS],
    sizes: [[Probability; SIZES]; SIZE_CONTEXTS],
    signs: [Probability; SIGN_CONTEXTS],
    /// The bit below the highest of a difference, by its size.
    second_bits: [Probability; SIZES],
}

/// `docs/encodings.md` states this size for firmware.
const _: () = assert!(size_of::<Model>() == 1104);

impl Default for Model {
    fn default() -> Self {
        Self {
            zones: [[Probability::EVEN; 2]; ZONE_SIZES],
            kinds: [[Probability::EVEN; 2]; CONTEXTS],
            corrections: [0; CONTEXTS],
            sizes: [[Probability::EVEN; SIZES]; SIZE_CONTEXTS],
            signs: [Probability::EVEN; SIGN_CONTEXTS],
            second_bits: [Probability::EVEN; SIZES],
        }
    }
}

impl Model {
    /// Writes the number of pixels that have the zone's colour before another comes. `zone` is the zone's length, at least 1.
    pub(super) fn put_run(&mut self, run: usize, zone: usize, colour: u8, coder: &mut RangeEncoder<'_>) {
        coder.put(run < zone, self.zone(zone, colour));
        if run < zone {
            coder.put_even(run as u32, place_bits(zone));
        }
    }

    /// Reads what [`put_run`](Self::put_run) wrote; `None` if the run would be longer than the zone.
    pub(super) fn take_run(&mut self, zone: usize, colour: u8, coder: &mut RangeDecoder) -> Option<usize> {
        if !coder.take(self.zone(zone, colour)) {
            return Some(zone);
        }
        Some(coder.take_even(place_bits(zone)) as usize).filter(|run| *run < zone)
    }

    fn zone(&mut self, zone: usize, colour: u8) -> &mut Probability {
        // A zone is empty only in a picture without columns.
        let size = (zone.max(1).ilog2() as usize).min(ZONE_SIZES - 1);
        &mut self.zones[size][usize::from(colour & 1)]
    }

    pub(super) fn put_pixel(&mut self, pixel: u8, near: Near, coder: &mut RangeEncoder<'_>) {
        let context = near.context();
        let [is_grey, is_lit] = &mut self.kinds[context];
        coder.put(!is_solid(pixel), is_grey);
        if is_solid(pixel) {
            coder.put(pixel == 255, is_lit);
            return;
        }
        let guess = self.guess(near, context);
        let difference = wrapped(i32::from(pixel) - guess, -GREYS / 2);
        let magnitude = difference.unsigned_abs();
        let size = u32::BITS - magnitude.leading_zeros();
        let tree = &mut self.sizes[near.size_context()];
        let mut node = 1;
        for place in (0..3).rev() {
            let bit = size >> place & 1;
            coder.put(bit == 1, &mut tree[node]);
            node = node * 2 + bit as usize;
        }
        if size > 0 {
            coder.put(difference < 0, &mut self.signs[guess as usize / 32]);
        }
        if size > 1 {
            coder.put(magnitude >> (size - 2) & 1 == 1, &mut self.second_bits[size as usize]);
            coder.put_even(magnitude & ((1 << (size - 2)) - 1), size - 2);
        }
        self.corrections[context] += (i32::from(pixel) - guess) as i16;
    }

    pub(super) fn take_pixel(&mut self, near: Near, coder: &mut RangeDecoder) -> u8 {
        let context = near.context();
        let [is_grey, is_lit] = &mut self.kinds[context];
        if !coder.take(is_grey) {
            return if coder.take(is_lit) { 255 } else { 0 };
        }
        let guess = self.guess(near, context);
        let tree = &mut self.sizes[near.size_context()];
        let mut node = 1;
        for _ in 0..3 {
            node = node * 2 + usize::from(coder.take(&mut tree[node]));
        }
        let size = node - SIZES;
        let is_negative = size > 0 && coder.take(&mut self.signs[guess as usize / 32]);
        let magnitude = match size {
            0 | 1 => size as u32,
            _ => {
                let high = 2 | u32::from(coder.take(&mut self.second_bits[size]));
                let low_bits = size as u32 - 2;
                high << low_bits | coder.take_even(low_bits)
            }
        };
        let difference = if is_negative { -(magnitude as i32) } else { magnitude as i32 };
        let pixel = wrapped(guess + difference, 1);
        self.corrections[context] += (pixel - guess) as i16;
        pixel as u8
    }

    /// Predicts a grey, 1 to 254: continues the slope of the row above, corrected by the errors of earlier guesses.
    ///
    /// A correction stays within ±8,500. It grows only while the guess is below 254, that is while a sixteenth of it is below 509.
    fn guess(&self, near: Near, context: usize) -> i32 {
        let plane = i32::from(near.left) + i32::from(near.up) - i32::from(near.corner);
        (plane + i32::from(self.corrections[context] >> CORRECTION_SHIFT)).clamp(1, GREYS)
    }
}

/// `value` modulo 254, in the range of 254 numbers that begins at `least`. `value` is at most 254 outside the range.
fn wrapped(value: i32, least: i32) -> i32 {
    if value < least {
        value + GREYS
    } else if value >= least + GREYS {
        value - GREYS
    } else {
        value
    }
}

/// Number of bits of a position within a zone.
fn place_bits(zone: usize) -> u32 {
    usize::BITS - (zone.max(1) - 1).leading_zeros()
}
