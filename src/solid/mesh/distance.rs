//! What triangles enclose as a field: by how far each pixel's centre lies within the solid of a plane. The distance is that from the nearest
//! segment, and the spans of [`Crossings`](super::Crossings) tell its sign.
//!
//! The distance is exact up to [`MARGIN_PX`] from the border: the border is interpolated between neighbouring pixels, so nothing farther away
//! matters. Segments within the solid, where pieces overlap, count as well: they change where the border is interpolated by less than a
//! pixel, and only next to the places where they meet it.

use std::ops::Range;

use super::section::Segment;

/// Pixels from the border up to which the distance is exact. Two neighbours are at most one pixel apart; half a pixel is to spare.
const MARGIN_PX: f64 = 1.5;

/// Some rows of a field.
#[derive(Debug)]
pub(crate) struct FieldRows {
    /// Minus the distance from the border, micrometres.
    values: Vec<f32>,
    width: usize,
    /// Pixel pitch, micrometres.
    pitch_um: [f64; 2],
    margin_um: f64,
    /// The first row.
    first: usize,
}

impl FieldRows {
    /// For up to `rows` rows of `width` pixels.
    pub(crate) fn new(width: usize, rows: usize, pitch_um: [f64; 2]) -> Self {
        let margin_um = MARGIN_PX * pitch_um[0].max(pitch_um[1]);
        Self { values: Vec::with_capacity(width * rows), width, pitch_um, margin_um, first: 0 }
    }

    /// Its memory, bytes.
    pub(crate) fn bytes(width: usize, rows: usize) -> u64 {
        (width * rows * size_of::<f32>()) as u64
    }

    /// Begins `count` rows from row `first` on: all lies outside.
    pub(crate) fn begin(&mut self, first: usize, count: usize) {
        self.first = first;
        self.values.clear();
        self.values.resize(count * self.width, -self.margin_um as f32);
    }

    /// The rows of segments that the rows from `first` on depend on.
    pub(crate) fn reach(&self, first: usize, count: usize) -> Range<i64> {
        let rows = (self.margin_um / self.pitch_um[1]).ceil() as i64;
        first as i64 - rows..(first + count) as i64 + rows
    }

    /// Adds a segment of the border.
    pub(crate) fn add(&mut self, segment: &Segment) {
        // Micrometres from the centre of the first pixel of the first row.
        let place = |end: [f64; 2]| [end[0] * self.pitch_um[0], (end[1] - self.first as f64) * self.pitch_um[1]];
        let [from, to] = [place(segment.from), place(segment.to)];
        let along = [to[0] - from[0], to[1] - from[1]];
        let squared = along[0] * along[0] + along[1] * along[1];
        let rows = self.pixels([from[1].min(to[1]), from[1].max(to[1])], 1, self.values.len() / self.width);
        for row in rows {
            let y = row as f64 * self.pitch_um[1];
            // The part of the segment near this row: all of a level one.
            let shares = if along[1] == 0.0 {
                [0.0, 1.0]
            } else {
                [-self.margin_um, self.margin_um].map(|off| ((y + off - from[1]) / along[1]).clamp(0.0, 1.0))
            };
            let ends = shares.map(|share| from[0] + share * along[0]);
            let pixels = self.pixels([ends[0].min(ends[1]), ends[0].max(ends[1])], 0, self.width);
            for (value, pixel) in self.values[row * self.width..][pixels.clone()].iter_mut().zip(pixels) {
                let away = [pixel as f64 * self.pitch_um[0] - from[0], y - from[1]];
                let nearest = if squared > 0.0 {
                    ((away[0] * along[0] + away[1] * along[1]) / squared).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                let [x, y] = [away[0] - nearest * along[0], away[1] - nearest * along[1]];
                // Never 0: a pixel outside has a negative excess.
                *value = value.max(-((x * x + y * y).sqrt() as f32).max(f32::MIN_POSITIVE));
            }
        }
    }

    /// The pixels within the margin of a range, along one axis.
    fn pixels(&self, [low, high]: [f64; 2], axis: usize, count: usize) -> Range<usize> {
        let [low, high] = [low - self.margin_um, high + self.margin_um].map(|at| at / self.pitch_um[axis]);
        // The casts saturate.
        let end = ((high.floor() + 1.0).max(0.0) as usize).min(count);
        (low.ceil().max(0.0) as usize).min(end)..end
    }

    /// Turns a span of a row, counted from the first, into solid.
    pub(crate) fn fill(&mut self, row: usize, span: Range<u32>) {
        let span = span.start as usize..span.end as usize;
        self.values[row * self.width..][span].iter_mut().for_each(|value| *value = -*value);
    }

    /// The excess of each row's pixels, micrometres.
    pub(crate) fn rows(&self) -> impl Iterator<Item = &[f32]> {
        self.values.chunks_exact(self.width)
    }
}
