//! RunGrey: 8-bit grey pictures as solid runs and the few values between them, arithmetically coded.
//!
//! An antialiased layer has dark (0) and lit (255) areas with one or two grey pixels at each edge, and each row is similar to the
//! row above. If all known neighbours of the next pixel have the same solid colour, a *zone* begins. It reaches as far as the
//! row above stays solid; a single, nearly certain bit says that this row stays solid, too. Elsewhere pixels are written one by
//! one: dark, lit, or grey with its difference from a prediction. A decoder needs only the current row, the previous row and
//! the `Model`. [`encode`](super::encode) and [`Decoder`](super::Decoder) use it.

use alloc::vec::Vec;

use super::error::DecodeError;
use super::grey_model::{Model, Near};
use super::range::{RangeDecoder, RangeEncoder};

/// Appends a grey picture to `bytes`, which must be empty.
pub(super) fn encode<'a>(rows: impl Iterator<Item = &'a [u8]>, bytes: &mut Vec<u8>) {
    let mut coder = RangeEncoder::new(bytes);
    let mut model = Model::default();
    let mut above: &[u8] = &[];
    for row in rows {
        encode_row(row, above, &mut model, &mut coder);
        above = row;
    }
    coder.finish();
}

fn encode_row(row: &[u8], above: &[u8], model: &mut Model, coder: &mut RangeEncoder<'_>) {
    let mut zones = Zones::default();
    let mut x = 0;
    while x < row.len() {
        let mut near = Near::at(row, above, x);
        if let Some(colour) = near.solid() {
            let end = zones.end(above, x, row.len(), colour);
            let stop = find_other(&row[..end], x, colour);
            model.put_run(stop - x, end - x, colour, coder);
            x = stop;
            if x == end {
                continue;
            }
            near = Near::at(row, above, x);
        }
        model.put_pixel(row[x], near, coder);
        x += 1;
    }
}

/// Limit of a zone: a position in it takes at most 16 bits, which the coder writes at once.
const MAX_ZONE_PX: usize = 0xffff;

/// Finds the ends of the zones of one row. The row above is searched only once, however often runs are broken in this row.
#[derive(Clone, Copy, Debug, Default)]
struct Zones {
    /// The end of the last run found in the row above.
    above_end: usize,
}

impl Zones {
    /// The end of the zone that begins at `x`: it reaches as far as the pixels above and ahead of it have `colour`.
    fn end(&mut self, above: &[u8], x: usize, width: usize, colour: u8) -> usize {
        if x >= self.above_end {
            self.above_end = if above.is_empty() { width } else { find_other(above, x, colour) };
        }
        // Outside the picture all is dark. So a dark zone can reach the edge, and a lit zone ends a pixel before it.
        let end = if self.above_end == width && colour == 0 { width } else { self.above_end - 1 };
        end.min(x + MAX_ZONE_PX)
    }
}

/// The first column from `x` on that is not `value`, else the row's length. Compares blocks, then words, then pixels.
fn find_other(row: &[u8], x: usize, value: u8) -> usize {
    let rest = &row[x.min(row.len())..];
    let (blocks, _) = rest.as_chunks::<64>();
    let is_same = |block: &&[u8; 64]| block.iter().fold(0, |differs, pixel| differs | (pixel ^ value)) == 0;
    let skipped = 64 * blocks.iter().take_while(is_same).count();
    let (words, tail) = rest[skipped..].as_chunks::<8>();
    let start = row.len() - rest.len() + skipped;
    for (index, word) in words.iter().enumerate() {
        let differs = u64::from_le_bytes(*word) ^ u64::from_le_bytes([value; 8]);
        if differs != 0 {
            return start + 8 * index + differs.trailing_zeros() as usize / 8;
        }
    }
    start + 8 * words.len() + tail.iter().take_while(|pixel| **pixel == value).count()
}

/// Decodes row after row.
#[derive(Debug, Default)]
pub(super) struct RowDecoder {
    model: Model,
    zones: Zones,
    x: usize,
    /// The last run ended before its zone did, so the pixel at `x` follows without a run.
    run_broken: bool,
}

impl RowDecoder {
    /// The most bytes that a step takes. A grey pixel has six learned bits of at most 11.1 bits each, and five even bits.
    pub(super) const STEP_BYTES: u32 = 12;

    /// Takes one run or one pixel. Returns whether `row` is complete. `above` is empty for the first row.
    pub(super) fn step(&mut self, coder: &mut RangeDecoder, above: &[u8], row: &mut [u8]) -> Result<bool, DecodeError> {
        let near = Near::at(row, above, self.x);
        match near.solid() {
            Some(colour) if !self.run_broken => {
                let zone = self.zones.end(above, self.x, row.len(), colour) - self.x;
                let run = self.model.take_run(zone, colour, coder).ok_or(DecodeError::BadCode)?;
                row[self.x..self.x + run].fill(colour);
                self.x += run;
                self.run_broken = run < zone;
            }
            _ => {
                row[self.x] = self.model.take_pixel(near, coder);
                self.x += 1;
                self.run_broken = false;
            }
        }
        let complete = self.x == row.len();
        if complete {
            (self.x, self.zones) = (0, Zones::default());
        }
        Ok(complete)
    }
}
