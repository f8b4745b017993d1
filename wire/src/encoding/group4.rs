//! CCITT Group 4 (ITU-T T.6): 1-bit pictures as changes against the row above.
//!
//! Lit is written as black. There is no header. The picture ends with EOFB and zero bits up to the next byte. The changes are
//! found a word at a time, because that takes most of the time. [`encode`](super::encode) and [`Decoder`](super::Decoder) use it.

use alloc::vec::Vec;

use super::bits::{BitReader, BitWriter};
use super::error::DecodeError;
use super::run_codes;

/// The mode codes of T.6 table 1: code and length.
const PASS: (u32, u32) = (0b0001, 4);
const HORIZONTAL: (u32, u32) = (0b001, 3);
/// For offsets from −3 (left of the change above) to +3.
const VERTICAL: [(u32, u32); 7] = [(0b10, 7), (0b10, 6), (0b10, 3), (1, 1), (0b11, 3), (0b11, 6), (0b11, 7)];
/// Two of these make up EOFB.
const EOL: (u32, u32) = (1, 12);

/// Appends a 1-bit picture to `bytes`.
pub(super) fn encode<'a>(rows: impl Iterator<Item = &'a [u8]>, width_px: u32, bytes: &mut Vec<u8>) {
    let mut writer = BitWriter::new(bytes);
    let (mut above, mut row) = (Vec::new(), Vec::new());
    for pixels in rows {
        find_changes(pixels, width_px, &mut row);
        encode_row(&row, &above, width_px, &mut writer);
        core::mem::swap(&mut above, &mut row);
    }
    writer.put(EOL.0, EOL.1);
    writer.put(EOL.0, EOL.1);
    writer.finish();
}

/// Finds the columns where the colour changes, ascending, starting from dark. Even entries begin lit runs, odd entries end them.
fn find_changes(pixels: &[u8], width_px: u32, changes: &mut Vec<u32>) {
    changes.clear();
    let mut last_bit = 0;
    let mut scan = |word: u64, first_x: u32| {
        // A bit is 1 where a pixel differs from its left neighbour.
        let mut differs = word ^ (word >> 1 | last_bit << 63);
        last_bit = word & 1;
        while differs != 0 {
            let place = differs.leading_zeros();
            changes.push(first_x + place);
            differs &= !(1 << 63 >> place);
        }
    };
    let (words, tail) = pixels.as_chunks::<8>();
    for (index, word) in words.iter().enumerate() {
        scan(u64::from_be_bytes(*word), index as u32 * 64);
    }
    if !tail.is_empty() {
        let mut last = [0; 8];
        last[..tail.len()].copy_from_slice(tail);
        scan(u64::from_be_bytes(last), words.len() as u32 * 64);
    }
    // The padding is dark. A lit run that ends at the edge has no change there.
    if changes.last().is_some_and(|&x| x >= width_px) {
        changes.pop();
    }
}

fn encode_row(row: &[u32], above: &[u32], width_px: u32, writer: &mut BitWriter<'_>) {
    let mut reference = Reference::new(above, width_px);
    let (mut a0, mut lit, mut next) = (None, false, 0);
    while a0.is_none_or(|a0| a0 < width_px) {
        let a1 = row.get(next).copied().unwrap_or(width_px);
        let (b1, b2) = reference.find(a0, lit);
        if b2 < a1 {
            writer.put(PASS.0, PASS.1);
            a0 = Some(b2);
        } else if a1.abs_diff(b1) <= 3 {
            let (code, length) = VERTICAL[(a1 + 3 - b1) as usize];
            writer.put(code, length);
            (a0, lit, next) = (Some(a1), !lit, next + 1);
        } else {
            let a2 = row.get(next + 1).copied().unwrap_or(width_px);
            writer.put(HORIZONTAL.0, HORIZONTAL.1);
            run_codes::put(a1 - a0.unwrap_or(0), lit, writer);
            run_codes::put(a2 - a1, !lit, writer);
            (a0, next) = (Some(a2), next + 2);
        }
    }
}

/// Finds b1 and b2 of T.6 in the row above, from left to right.
struct Reference<'a> {
    changes: &'a [u32],
    width_px: u32,
    next: usize,
}

impl<'a> Reference<'a> {
    fn new(changes: &'a [u32], width_px: u32) -> Self {
        Self { changes, width_px, next: 0 }
    }

    /// b1 is the first change right of `a0` away from the colour `lit`, b2 the change after it. Either is the width if there is none.
    fn find(&mut self, a0: Option<u32>, lit: bool) -> (u32, u32) {
        if let Some(a0) = a0 {
            // After a vertical code to the left, a few passed changes may lie ahead again.
            while self.next > 0 && self.changes[self.next - 1] > a0 {
                self.next -= 1;
            }
            while self.changes.get(self.next).is_some_and(|&x| x <= a0) {
                self.next += 1;
            }
        }
        let at = |index: usize| self.changes.get(index).copied().unwrap_or(self.width_px);
        let first = self.next + usize::from((self.next % 2 == 1) != lit);
        (at(first), at(first + 1))
    }
}

/// Decodes row after row into pixels.
#[derive(Debug)]
pub(super) struct RowDecoder {
    width_px: u32,
    above: Vec<u32>,
    row: Vec<u32>,
    a0: Option<u32>,
    lit: bool,
    /// The horizontal code under way.
    horizontal: Horizontal,
}

#[derive(Clone, Copy, Debug)]
enum Horizontal {
    No,
    /// The first run so far (make-up codes).
    First(u32),
    Second(u32),
}

impl RowDecoder {
    pub(super) fn new(width_px: u32) -> Self {
        Self { width_px, above: Vec::new(), row: Vec::new(), a0: None, lit: false, horizontal: Horizontal::No }
    }

    /// Takes one code. Returns whether the row is complete; it is then in `pixels`, which must be all 0 before.
    pub(super) fn step(&mut self, bits: &mut BitReader, pixels: &mut [u8]) -> Result<bool, DecodeError> {
        match self.horizontal {
            Horizontal::No => self.take_mode(bits)?,
            Horizontal::First(run) | Horizontal::Second(run) => self.take_run(run, bits)?,
        }
        if self.a0.is_none_or(|a0| a0 < self.width_px) || !matches!(self.horizontal, Horizontal::No) {
            return Ok(false);
        }
        for run in self.row.chunks(2) {
            fill_bits(pixels, run[0], run.get(1).copied().unwrap_or(self.width_px));
        }
        core::mem::swap(&mut self.above, &mut self.row);
        self.row.clear();
        (self.a0, self.lit) = (None, false);
        Ok(true)
    }

    fn take_mode(&mut self, bits: &mut BitReader) -> Result<(), DecodeError> {
        let mode = take_mode(bits)?;
        let (b1, b2) = Reference::near(&self.above, self.width_px, self.a0, self.lit);
        match mode {
            Mode::Pass if b2 < self.width_px => self.a0 = Some(b2),
            Mode::Pass => return Err(DecodeError::BadCode),
            Mode::Horizontal => self.horizontal = Horizontal::First(0),
            Mode::Vertical(shift) => self.change(b1.checked_add_signed(shift).ok_or(DecodeError::BadCode)?)?,
        }
        Ok(())
    }

    fn take_run(&mut self, run: u32, bits: &mut BitReader) -> Result<(), DecodeError> {
        let second = matches!(self.horizontal, Horizontal::Second(_));
        let code = run_codes::take(self.lit, bits).ok_or(DecodeError::BadCode)?;
        let run = run + code;
        if run > self.width_px {
            return Err(DecodeError::BadCode);
        }
        if code >= 64 {
            self.horizontal = if second { Horizontal::Second(run) } else { Horizontal::First(run) };
            return Ok(());
        }
        // `change` flips the colour, and with it the code table of the second run.
        self.change(self.a0.unwrap_or(0) + run)?;
        self.horizontal = if second { Horizontal::No } else { Horizontal::Second(0) };
        Ok(())
    }

    /// The colour changes at `x`, which must advance, except in a row that begins lit and at the end of a row.
    fn change(&mut self, x: u32) -> Result<(), DecodeError> {
        let advances = self.a0.is_none_or(|a0| x > a0) || x == self.width_px;
        if !advances || x > self.width_px {
            return Err(DecodeError::BadCode);
        }
        if x < self.width_px {
            self.row.push(x);
        }
        (self.a0, self.lit) = (Some(x), !self.lit);
        Ok(())
    }
}

/// How the next change lies to those of the row above.
#[derive(Clone, Copy)]
enum Mode {
    Pass,
    Horizontal,
    /// Pixels right of b1.
    Vertical(i32),
}

/// Takes one code of T.6 table 1: up to six zeros, a one, and for offsets a bit for their sign.
fn take_mode(bits: &mut BitReader) -> Result<Mode, DecodeError> {
    let next = bits.peek(7);
    let offset = |length: u32, size: i32| {
        let right = next >> (7 - length) & 1 == 1;
        (Mode::Vertical(if right { size } else { -size }), length)
    };
    let (mode, length) = match (next << (u32::BITS - 7)).leading_zeros() {
        0 => (Mode::Vertical(0), 1),
        1 => offset(3, 1),
        2 => (Mode::Horizontal, 3),
        3 => (Mode::Pass, 4),
        4 => offset(6, 2),
        5 => offset(7, 3),
        // The end of the picture. The code with six zeros is an extension that is not used.
        7.. if bits.peek(EOL.1) == EOL.0 => return Err(DecodeError::TooFewRows),
        _ => return Err(DecodeError::BadCode),
    };
    bits.skip(length);
    Ok(mode)
}

impl Reference<'_> {
    /// [`find`](Self::find) for a single position.
    fn near(changes: &[u32], width_px: u32, a0: Option<u32>, lit: bool) -> (u32, u32) {
        let next = a0.map_or(0, |a0| changes.partition_point(|&x| x <= a0));
        Reference { changes, width_px, next }.find(None, lit)
    }
}

/// Checks that only EOFB and zero bits up to the next byte follow.
pub(super) fn take_end(bits: &mut BitReader) -> Result<(), DecodeError> {
    if bits.remaining() < 24 {
        return Err(DecodeError::TooFewRows);
    }
    if bits.take(24) != 0x00_1001 {
        return Err(DecodeError::TooManyRows);
    }
    match bits.remaining() {
        8.. => Err(DecodeError::TooManyRows),
        left if left > 0 && bits.peek(left) != 0 => Err(DecodeError::BadPadding),
        _ => Ok(()),
    }
}

/// Sets the pixels from `start` up to, but not including, `end`.
fn fill_bits(pixels: &mut [u8], start: u32, end: u32) {
    let (first, last) = ((start / 8) as usize, (end / 8) as usize);
    let (head, tail) = (0xffu8 >> (start % 8), !(0xffu8 >> (end % 8)));
    if first == last {
        pixels[first] |= head & tail;
        return;
    }
    pixels[first] |= head;
    pixels[first + 1..last].fill(0xff);
    // If a run ends with the last byte of the row, there is no byte after it.
    if tail != 0 {
        pixels[last] |= tail;
    }
}
