//! What RunGrey expects of a pixel or a run, learned from those before it.
//!
//! Everything a decoder keeps besides two rows is the [`Model`]: 1104 bytes. `docs/encodings.md` says the same in words.

use super::range::{Probability, RangeDecoder, RangeEncoder};

/// The pixels around the next one that are known by then; 0 outside the picture.
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

    /// The colour of all four where they are solid and the same: most likely it goes on.
    pub(super) fn solid(self) -> Option<u8> {
        let Self { left, corner, up, ahead } = self;
        (is_solid(left) && [corner, up, ahead] == [left; 3]).then_some(left)
    }

    /// One of [`CONTEXTS`].
    fn context(self) -> usize {
        let four = |pixel: u8| three(pixel) + usize::from(pixel > 127);
        ((four(self.left) * 4 + four(self.up)) * 3 + three(self.ahead)) * 3 + three(self.corner)
    }

    fn size_context(self) -> usize {
        three(self.left) * 3 + three(self.up)
    }
}

/// The kinds of neighbourhood told apart.
const CONTEXTS: usize = 4 * 4 * 3 * 3;
/// The kinds of neighbourhood in which differences differ in size.
const SIZE_CONTEXTS: usize = 3 * 3;
/// Differences of 7 bits: their sizes are 0 to 7, their size's tree has seven nodes (counted from 1).
const SIZES: usize = 8;
/// Guesses told apart for a difference's sign: near 0 it is mostly positive, near 255 negative.
const SIGN_CONTEXTS: usize = 8;
/// Bits of a zone's length, less one: a zone has at most 65535 pixels.
const ZONE_SIZES: usize = 16;
/// Grey pixels are 1 to 254.
const GREYS: i32 = 254;
/// Corrections are kept in sixteenths: as long as the memory of a context.
const CORRECTION_SHIFT: u32 = 4;

/// Dark, grey, lit; without jumps, which could not be foretold.
fn three(pixel: u8) -> usize {
    usize::from(pixel > 0) + usize::from(pixel == 255)
}

pub(super) fn is_solid(pixel: u8) -> bool {
    pixel == 0 || pixel == 255
}

/// The state of the coder, as large for a decoder as for an encoder.
#[derive(Clone, Debug)]
pub(super) struct Model {
    /// Whether a run ends before its zone does: by the zone's size and colour.
    zones: [[Probability; 2]; ZONE_SIZES],
    /// Whether a pixel is grey; if not, whether it is lit.
    kinds: [[Probability; 2]; CONTEXTS],
    /// Sum of what the guesses lacked: a sixteenth of it is added to the next.
    corrections: [i16; CONTEXTS],
    sizes: [[Probability; SIZES]; SIZE_CONTEXTS],
    signs: [Probability; SIGN_CONTEXTS],
    /// The bit below the highest of a difference, by its size.
    second_bits: [Probability; SIZES],
}

/// What `docs/encodings.md` tells firmware writers to set aside.
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
    /// Writes how many of a zone's `zone` pixels (at least 1) have its colour before another comes.
    pub(super) fn put_run(&mut self, run: usize, zone: usize, colour: u8, coder: &mut RangeEncoder<'_>) {
        coder.put(run < zone, self.zone(zone, colour));
        if run < zone {
            coder.put_even(run as u32, place_bits(zone));
        }
    }

    /// Reads what [`put_run`](Self::put_run) wrote; `None` for a place beyond the zone, which no picture has.
    pub(super) fn take_run(&mut self, zone: usize, colour: u8, coder: &mut RangeDecoder) -> Option<usize> {
        if !coder.take(self.zone(zone, colour)) {
            return Some(zone);
        }
        Some(coder.take_even(place_bits(zone)) as usize).filter(|run| *run < zone)
    }

    fn zone(&mut self, zone: usize, colour: u8) -> &mut Probability {
        // Only a picture without columns has an empty zone.
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

    /// The grey that continues the row above's slope, corrected by what such guesses lacked; 1 to 254.
    ///
    /// A correction stays within ±8,500: it only grows while the guess is below 254, so while a sixteenth of it is below 509.
    fn guess(&self, near: Near, context: usize) -> i32 {
        let plane = i32::from(near.left) + i32::from(near.up) - i32::from(near.corner);
        (plane + i32::from(self.corrections[context] >> CORRECTION_SHIFT)).clamp(1, GREYS)
    }
}

/// The number from `least` on, of 254, that `value` is a whole number of 254s away from; at most one.
fn wrapped(value: i32, least: i32) -> i32 {
    if value < least {
        value + GREYS
    } else if value >= least + GREYS {
        value - GREYS
    } else {
        value
    }
}

/// Bits of a place within a zone.
fn place_bits(zone: usize) -> u32 {
    usize::BITS - (zone.max(1) - 1).leading_zeros()
}
