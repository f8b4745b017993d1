//! RunGrey: 8-bit grey pictures as solid runs against the row above, and the few values between them.
//!
//! An antialiased layer is dark (0) and lit (255) areas with one or two values at each edge, and each row is nearly the row
//! above it. A decoder needs the current and the previous row and four pairs of counters, nothing else.
//!
//! Bits fill bytes from the highest down. Rows follow one another without a mark, pixels from left to right. Below, `up` is
//! the row above (all 0 above the first row), `left` the pixel before the current one (0 before the first of a row), `W` the
//! width. There are two kinds of code:
//!
//! **Run.** Wherever `left` is 0 or 255 (so at the start of every row), the number of further pixels of that value follows, as
//! the place `a` of the first pixel that differs, or `W`. Let `b` be the first place `p` at or right of the current pixel
//! with `up[p - 1] = left` and `up[p] ≠ left` (`up[-1]` is 0); `W` if there is none. Written is `d = a − b`, folded to a number
//! from 0 (`2d` for `d ≥ 0`, `−2d − 1` for `d < 0`), in the Exp-Golomb code of order 0: for the number `n`, as many zeros as
//! `n + 1` has bits after its first, then `n + 1` in binary. `shift` becomes `d`. If `a < W` a value follows.
//!
//! **Value.** The pixel is guessed from its left neighbour and from the edge above it, moved along by `shift`: with
//! `u = up[x − shift]` and `c = up[x − 1 − shift]` (0 outside the row), the guess is the middle one of `left`, `u` and
//! `left + u − c`. Written is the pixel minus the guess, modulo 256 as −128 to 127, folded as above, in a Golomb-Rice code
//! whose parameter `k` follows the values seen so far in one of four contexts, chosen by `2·(left is neither 0 nor 255) + (u is neither
//! 0 nor 255)`. A context begins with `sum = 16, count = 1`. `k` is the smallest number, at most 7, with `count·2^k ≥ sum`. The number `n`
//! is written as `n >> k` zeros, a one, and the lowest `k` bits of `n`; where that would take 12 zeros or more, as 12 zeros
//! and the 8 bits of `n` (without the one). Then `sum += n` and `count += 1`; when `count` reaches 32, both are halved
//! (rounding down). While pixels are neither 0 nor 255 the next value follows; after a 0 or 255 a run follows.
//!
//! After the last row the last byte is filled with zeros.

use super::bits::{BitReader, BitWriter};
use super::decoder::DecodeError;
use crate::slice::Bitmap;

/// Zeros that announce a value written plainly.
const ESCAPE_ZEROS: u32 = 12;
/// Counters are halved here: an edge of another slope is learned within about as many values.
const HALVE_AT: u32 = 32;

/// Appends a grey picture to `bytes`.
pub(super) fn encode(bitmap: &Bitmap, bytes: &mut Vec<u8>) {
    let width = bitmap.width_px() as usize;
    let mut writer = BitWriter::new(bytes);
    let mut contexts = [Context::NEW; 4];
    let dark = vec![0; width];
    let mut above: &[u8] = &dark;
    for row in bitmap.data().chunks_exact(width.max(1)) {
        encode_row(row, above, &mut contexts, &mut writer);
        above = row;
    }
    writer.finish();
}

fn encode_row(row: &[u8], above: &[u8], contexts: &mut [Context; 4], writer: &mut BitWriter<'_>) {
    let mut ends = [RunEnd::default(); 2];
    let (mut x, mut left, mut shift) = (0, 0, 0);
    while x < row.len() {
        if is_solid(left) {
            let a = find_other(row, x, left);
            let b = ends[usize::from(left & 1)].find(above, x, left);
            shift = a as isize - b as isize;
            put_exp_golomb(fold(shift as i32), writer);
            x = a;
        }
        if let Some(&pixel) = row.get(x) {
            let (guess, context) = guess(above, x, left, shift);
            contexts[context].put(fold(i32::from(pixel.wrapping_sub(guess) as i8)), writer);
            (left, x) = (pixel, x + 1);
        }
    }
}

fn is_solid(pixel: u8) -> bool {
    pixel == 0 || pixel == 255
}

/// The end of a run in the row above; kept between questions, so that a row is searched once.
#[derive(Clone, Copy, Debug, Default)]
struct RunEnd(Option<usize>);

impl RunEnd {
    /// The first place at or right of `x` where a run of `value` ends in `above`, else the width.
    fn find(&mut self, above: &[u8], x: usize, value: u8) -> usize {
        match self.0 {
            Some(end) if end >= x => end,
            _ => {
                let end = find_run_end(above, x, value);
                self.0 = Some(end);
                end
            }
        }
    }
}

fn find_run_end(above: &[u8], x: usize, value: u8) -> usize {
    let before = if x == 0 { 0 } else { above[x - 1] };
    let inside = if before == value { x } else { find_value(above, x, value) };
    find_other(above, inside, value)
}

/// The first place at or right of `x` that is not `value`, else the width.
fn find_other(row: &[u8], x: usize, value: u8) -> usize {
    let pattern = u64::from_ne_bytes([value; 8]);
    scan(row, x, |pixel| pixel != value, |word| word != pattern)
}

/// The first place at or right of `x` that is `value` (0 or 255), else the width.
fn find_value(row: &[u8], x: usize, value: u8) -> usize {
    let flip = if value == 0 { 0 } else { u64::MAX };
    // A byte of `y` is 0 exactly where the highest bit of the expression can first be set; later false hits do not matter.
    let has_value = |word: u64| {
        let y = word ^ flip;
        y.wrapping_sub(0x0101_0101_0101_0101) & !y & 0x8080_8080_8080_8080 != 0
    };
    scan(row, x, |pixel| pixel == value, has_value)
}

/// Goes through a row by words that cannot hold what is looked for, then by pixels.
fn scan(row: &[u8], x: usize, is_hit: impl Fn(u8) -> bool, has_hit: impl Fn(u64) -> bool) -> usize {
    let rest = &row[x.min(row.len())..];
    let (words, _) = rest.as_chunks::<8>();
    let skipped = words.iter().position(|word| has_hit(u64::from_ne_bytes(*word))).unwrap_or(words.len()) * 8;
    let found = rest[skipped..].iter().position(|&pixel| is_hit(pixel));
    row.len() - rest.len() + skipped + found.unwrap_or(rest.len() - skipped)
}

/// The guess for the pixel at `x`, and the context of its code.
fn guess(above: &[u8], x: usize, left: u8, shift: isize) -> (u8, usize) {
    let at = |place: usize| place.checked_add_signed(-shift).and_then(|p| above.get(p)).copied().unwrap_or(0);
    let up = at(x);
    let corner = if x == 0 { 0 } else { at(x - 1) };
    let plane = i32::from(left) + i32::from(up) - i32::from(corner);
    let guess = plane.clamp(i32::from(left.min(up)), i32::from(left.max(up))) as u8;
    (guess, 2 * usize::from(!is_solid(left)) + usize::from(!is_solid(up)))
}

/// Signed to unsigned: 0, −1, 1, −2, 2 … become 0, 1, 2, 3, 4 ….
fn fold(value: i32) -> u32 {
    (value << 1 ^ value >> 31) as u32
}

fn unfold(number: u32) -> i32 {
    (number >> 1) as i32 ^ -((number & 1) as i32)
}

fn put_exp_golomb(number: u32, writer: &mut BitWriter<'_>) {
    let bits = (number + 1).ilog2();
    writer.put(0, bits);
    writer.put(number + 1, bits + 1);
}

/// The longest run code: a place within 2^16 pixels, folded, has at most 18 bits.
const MOST_RUN_ZEROS: u32 = 17;

fn take_exp_golomb(bits: &mut BitReader) -> Result<u32, DecodeError> {
    let zeros = bits.leading_zeros(MOST_RUN_ZEROS + 1);
    if zeros > MOST_RUN_ZEROS {
        return Err(DecodeError::BadCode);
    }
    bits.skip(zeros);
    Ok(bits.take(zeros + 1) - 1)
}

/// What the values of one context were like.
#[derive(Clone, Copy, Debug)]
struct Context {
    sum: u32,
    count: u32,
}

impl Context {
    const NEW: Self = Self { sum: 16, count: 1 };

    fn parameter(self) -> u32 {
        (0..7).find(|k| self.count << k >= self.sum).unwrap_or(7)
    }

    fn learn(&mut self, number: u32) {
        self.sum += number;
        self.count += 1;
        if self.count == HALVE_AT {
            self.sum /= 2;
            self.count /= 2;
        }
    }

    fn put(&mut self, number: u32, writer: &mut BitWriter<'_>) {
        let k = self.parameter();
        let zeros = number >> k;
        if zeros < ESCAPE_ZEROS {
            writer.put(1 << k | number & ((1 << k) - 1), zeros + 1 + k);
        } else {
            writer.put(number, ESCAPE_ZEROS + 8);
        }
        self.learn(number);
    }

    fn take(&mut self, bits: &mut BitReader) -> u32 {
        let k = self.parameter();
        let zeros = bits.leading_zeros(ESCAPE_ZEROS);
        bits.skip(zeros);
        let number = if zeros < ESCAPE_ZEROS {
            bits.skip(1);
            zeros << k | bits.take(k)
        } else {
            bits.take(8)
        };
        // Eight bits hold every folded value; a longer one is garbage, and what becomes of it the CRC will tell.
        let number = number & 0xff;
        self.learn(number);
        number
    }
}

/// Decodes row after row.
#[derive(Debug)]
pub(super) struct RowDecoder {
    contexts: [Context; 4],
    x: usize,
    left: u8,
    shift: isize,
    /// Whether the run before the pixel at `x` was read.
    run_known: bool,
    ends: [RunEnd; 2],
}

impl RowDecoder {
    pub(super) fn new() -> Self {
        Self { contexts: [Context::NEW; 4], x: 0, left: 0, shift: 0, run_known: false, ends: Default::default() }
    }

    /// Takes one code; true where it completed `row`. `above` is empty for the first row.
    pub(super) fn step(&mut self, bits: &mut BitReader, above: &[u8], row: &mut [u8]) -> Result<bool, DecodeError> {
        if is_solid(self.left) && !self.run_known {
            // Above the first row all is dark, so a run ends there with the row.
            let end = &mut self.ends[usize::from(self.left & 1)];
            let b = if above.is_empty() { row.len() } else { end.find(above, self.x, self.left) };
            let shift = unfold(take_exp_golomb(bits)?) as isize;
            let end = b.checked_add_signed(shift).filter(|end| (self.x..=row.len()).contains(end));
            let end = end.ok_or(DecodeError::BadCode)?;
            row[self.x..end].fill(self.left);
            (self.x, self.shift, self.run_known) = (end, shift, true);
        } else {
            let (guess, context) = guess(above, self.x, self.left, self.shift);
            let pixel = guess.wrapping_add(unfold(self.contexts[context].take(bits)) as u8);
            row[self.x] = pixel;
            (self.x, self.left, self.run_known) = (self.x + 1, pixel, false);
        }
        let complete = self.x == row.len();
        if complete {
            (self.x, self.left, self.run_known, self.ends) = (0, 0, false, Default::default());
        }
        Ok(complete)
    }
}
