//! Segments of a plane to spans of pixels: where each row crosses them, and where the winding number is above 0. `tests/surface` tests it.

use std::ops::Range;

use super::counts::Counts;
use super::section::Segment;

/// Most crossings that are kept: those of a usual band. They take 96 KiB, less than a level-2 cache has.
const MAX_CROSSINGS: usize = 1 << 13;

/// How finely a band is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Resolution {
    /// Samples along a row for each pixel.
    pub(crate) columns: u32,
    /// Rows of samples for each row of pixels.
    pub(crate) rows: u32,
}

impl Resolution {
    /// One sample in the centre of each pixel.
    pub(crate) const CENTRES: Self = Self { columns: 1, rows: 1 };

    /// 256 samples a pixel, so that a count of them is a grey value.
    pub(crate) const GREY: Self = Self { columns: 32, rows: 8 };

    /// A place in pixels as one in samples, both counted from the centre of the first.
    fn samples(self, [x, y]: [f64; 2]) -> [f64; 2] {
        if self == Self::CENTRES {
            return [x, y];
        }
        let scaled = |at: f64, count: u32| (at + 0.5) * f64::from(count) - 0.5;
        [scaled(x, self.columns), scaled(y, self.rows)]
    }
}

/// The crossings of some rows of pixels. It takes a fixed amount of memory: where one row of pixels alone has more crossings than there is
/// room for, they are counted for each sample instead.
#[derive(Debug)]
pub(crate) struct Crossings {
    resolution: Resolution,
    /// Samples in a row.
    width: u32,
    capacity: usize,
    /// The row of samples of each crossing, and its key: twice the first sample behind it, plus 1 if the winding number falls there.
    found: Vec<[u32; 2]>,
    /// The keys, row by row.
    keys: Vec<u32>,
    /// Where the keys of each row of samples end.
    ends: Vec<u32>,
    /// In place of the above, where they have no room for one row of pixels.
    counts: Counts,
    /// The first row of samples.
    first: f64,
    is_full: bool,
}

impl Crossings {
    /// For up to `rows` rows of `width` pixels.
    pub(crate) fn new(width: usize, rows: usize, resolution: Resolution) -> Self {
        Self::with_capacity(width, rows, resolution, MAX_CROSSINGS)
    }

    fn with_capacity(width: usize, rows: usize, resolution: Resolution, capacity: usize) -> Self {
        let width = width as u32 * resolution.columns;
        Self {
            resolution,
            width,
            capacity,
            found: Vec::with_capacity(capacity),
            keys: Vec::with_capacity(capacity),
            ends: Vec::with_capacity(rows * resolution.rows as usize),
            counts: Counts::new(width, resolution.rows as usize),
            first: 0.0,
            is_full: false,
        }
    }

    /// Its memory, bytes.
    pub(crate) fn bytes(width: usize, rows: usize, resolution: Resolution) -> u64 {
        let keys = MAX_CROSSINGS * (size_of::<[u32; 2]>() + size_of::<u32>());
        let ends = rows * resolution.rows as usize * size_of::<u32>();
        let counts = Counts::bytes(width as u32 * resolution.columns, resolution.rows as usize);
        (keys + ends) as u64 + counts
    }

    /// Begins `count` rows of pixels from row `first` on.
    pub(crate) fn begin(&mut self, first: usize, count: usize) {
        let rows = self.resolution.rows as usize;
        self.first = (first * rows) as f64;
        self.found.clear();
        self.ends.clear();
        self.ends.resize(count * rows, 0);
        self.counts.clear();
        self.is_full = false;
    }

    /// Whether there was room for twice as many crossings.
    pub(crate) fn is_half_empty(&self) -> bool {
        !self.counts.is_used() && 2 * self.found.len() <= self.capacity
    }

    /// Adds a segment. `is_mirrored`: the solid lies to its right.
    #[inline]
    pub(crate) fn add(&mut self, segment: &Segment, is_mirrored: bool) {
        let (from, to) = (self.resolution.samples(segment.from), self.resolution.samples(segment.to));
        let goes_up = from[1] < to[1];
        let (low, high) = if goes_up { (from, to) } else { (to, from) };
        // The row at its upper end belongs to the next segment.
        let count = self.ends.len() as f64;
        let rows = ceil(low[1] - self.first, count)..ceil(high[1] - self.first, count);
        if rows.is_empty() || self.found.len() + rows.len() > self.capacity && !self.make_room() {
            return;
        }
        let slope = (high[0] - low[0]) / (high[1] - low[1]);
        let falls = u32::from(goes_up != is_mirrored);
        let (first, width) = (self.first, f64::from(self.width));
        self.found.extend(rows.map(|row| {
            let at = low[0] + (first + f64::from(row) - low[1]) * slope;
            [row, ceil(at, width) << 1 | falls]
        }));
    }

    /// Counts what was found if it is of one row of pixels; otherwise there is no room.
    fn make_room(&mut self) -> bool {
        self.is_full = self.ends.len() > self.resolution.rows as usize;
        if !self.is_full {
            self.count_found();
        }
        !self.is_full
    }

    fn count_found(&mut self) {
        for [row, key] in self.found.drain(..) {
            self.counts.add(row as usize, key >> 1, change(key));
        }
    }

    /// Whether crossings were left out because there was no room. Then begin again with fewer rows: one row of pixels always has room.
    pub(crate) fn is_full(&self) -> bool {
        self.is_full
    }

    /// Calls `fill` with each row of pixels, counted from the first, and each span of samples in it whose winding number is above 0. A row of
    /// pixels may have several rows of samples.
    pub(crate) fn spans(&mut self, mut fill: impl FnMut(usize, Range<u32>)) {
        if self.counts.is_used() {
            self.count_found();
            self.counts.spans(|span| fill(0, span));
            return;
        }
        self.sort();
        let mut begin_of_row = 0;
        for (row, end_of_row) in self.ends.iter().enumerate() {
            let (mut winding, mut begin) = (0, 0);
            for key in &self.keys[begin_of_row..*end_of_row as usize] {
                let sample = key >> 1;
                let before = winding;
                winding += change(*key);
                match (before > 0, winding > 0) {
                    (false, true) => begin = sample,
                    (true, false) if begin < sample => fill(row / self.resolution.rows as usize, begin..sample),
                    _ => {}
                }
            }
            begin_of_row = *end_of_row as usize;
        }
    }

    /// Puts the keys in order, row by row. Where the winding number rises and falls at one sample, it rises first.
    fn sort(&mut self) {
        self.found.iter().for_each(|[row, _]| self.ends[*row as usize] += 1);
        let mut place = 0;
        for count in &mut self.ends {
            place += std::mem::replace(count, place);
        }
        self.keys.clear();
        self.keys.resize(self.found.len(), 0);
        for [row, key] in &self.found {
            let place = &mut self.ends[*row as usize];
            self.keys[*place as usize] = *key;
            *place += 1;
        }
        let mut begin = 0;
        for end in &self.ends {
            self.keys[begin..*end as usize].sort_unstable();
            begin = *end as usize;
        }
    }
}

/// The next whole number above, from 0 to the whole number `most`, which is below 2³². `f64::ceil` is a function call on processors
/// without SSE 4.1, and a cast that saturates is slow.
fn ceil(value: f64, most: f64) -> u32 {
    /// Added to it, a number is rounded to a whole one, which the lowest bits of the sum are.
    const WHOLE: f64 = (1_u64 << 52) as f64;
    let value = if value < most { value } else { most };
    let value = if value > 0.0 { value } else { 0.0 };
    let sum = value + WHOLE;
    sum.to_bits() as u32 + u32::from(sum - WHOLE < value)
}

/// By how much the winding number changes at a crossing.
fn change(key: u32) -> i32 {
    1 - 2 * (key & 1) as i32
}

/// Sets a span of the bits of a row, which is not empty. The first pixel of a byte is its highest bit.
pub(crate) fn set_bits(line: &mut [u8], span: Range<u32>) {
    let (first, last) = ((span.start / 8) as usize, ((span.end - 1) / 8) as usize);
    let (head, tail) = (0xff_u8 >> (span.start % 8), 0xff_u8 << (7 - (span.end - 1) % 8));
    if first == last {
        line[first] |= head & tail;
        return;
    }
    line[first] |= head;
    line[first + 1..last].fill(0xff);
    line[last] |= tail;
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The spans of squares, each of one height.
    fn spans(squares: &[[f64; 3]], resolution: Resolution) -> Vec<(usize, Range<u32>)> {
        let mut crossings = Crossings::new(20, 8, resolution);
        crossings.begin(2, 4);
        for [low, high, way] in squares {
            let mut corners = [[*low, *low], [*high, *low], [*high, *high], [*low, *high]];
            if *way < 0.0 {
                corners.reverse();
            }
            for corner in 0..4 {
                crossings.add(&Segment { from: corners[corner], to: corners[(corner + 1) % 4] }, false);
            }
        }
        let mut spans = Vec::new();
        crossings.spans(|row, span| spans.push((row, span)));
        spans
    }

    #[test]
    fn overlapping_pieces_are_one_solid_and_reversed_ones_are_cavities() {
        let rows = |spans: &[[u32; 2]]| {
            let spans = spans.iter().map(|[begin, end]| *begin..*end);
            (0..4).flat_map(|row| spans.clone().map(move |span| (row, span))).collect::<Vec<_>>()
        };
        let centres = Resolution::CENTRES;
        assert_eq!(spans(&[[1.0, 9.0, 1.0]], centres), rows(&[[1, 9]]), "the border belongs to one side");
        assert_eq!(spans(&[[1.0, 9.0, 1.0], [1.5, 12.5, 1.0]], centres), rows(&[[1, 13]]));
        assert_eq!(spans(&[[1.0, 9.0, 1.0], [1.9, 6.5, -1.0]], centres), rows(&[[1, 2], [7, 9]]));
        assert_eq!(spans(&[[1.0, 9.0, -1.0]], centres), rows(&[]), "inside out there is nothing");
        assert_eq!(spans(&[[1.0, 9.0, 1.0], [9.0, 12.0, 1.0]], centres), rows(&[[1, 9]]), "rows 2 to 5 miss the other");
    }

    #[test]
    fn grey_samples_count_the_area_of_a_pixel() {
        // Half of the columns and half of the rows of pixel 2 in row 2, which reaches from 1.5 to 2.5.
        let spans = spans(&[[1.75, 2.25, 1.0]], Resolution::GREY);
        assert_eq!(spans.iter().map(|(row, span)| (*row, span.len())).collect::<Vec<_>>(), [(0, 16); 4]);
    }

    #[test]
    fn numbers_are_rounded_up_within_their_limits() {
        for value in [-1e300, -0.5, -1e-300, 0.0, 1e-300, 0.49, 0.5, 1.0, 1.0 + 1e-15, 2.5, 3.5, 6.9, 7.0, 7.1, 1e300] {
            assert_eq!(ceil(value, 7.0), value.ceil().clamp(0.0, 7.0) as u32, "{value}");
        }
        assert_eq!(ceil(4_294_967_293.5, 4_294_967_295.0), 4_294_967_294);
    }

    #[test]
    fn too_many_crossings_are_told() {
        let mut crossings = Crossings::new(20, 4096, Resolution::CENTRES);
        let wall = |x: f64, up: bool| {
            let ends = [[x, -1.0], [x, 5000.0]];
            Segment { from: ends[usize::from(!up)], to: ends[usize::from(up)] }
        };
        crossings.begin(0, 4096);
        for _ in 0..20 {
            crossings.add(&wall(3.0, true), false);
        }
        assert!(crossings.is_full());
        crossings.begin(0, 1);
        for _ in 0..100_000 {
            crossings.add(&wall(3.0, false), false);
            crossings.add(&wall(7.5, true), false);
        }
        assert!(!crossings.is_full(), "one row always has room");
        let mut spans = Vec::new();
        crossings.spans(|row, span| spans.push((row, span)));
        assert_eq!(spans, [(0, 3..8)]);
    }

    /// Segments whose ends often share their rows and columns, in and beside a picture of 12 by 4 pixels.
    fn segments() -> impl Strategy<Value = Vec<(Segment, bool)>> {
        let at = prop_oneof![-3.0..15.0, (-3..15).prop_map(f64::from), (-12..60).prop_map(|at| f64::from(at) / 4.0)];
        let end = || (at.clone(), at.clone()).prop_map(|(x, y)| [x, y]);
        let segment = (end(), end()).prop_map(|(from, to)| Segment { from, to });
        proptest::collection::vec((segment, any::<bool>()), 0..60)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn counts_and_sorted_crossings_have_equal_spans(segments in segments(), capacity in 8..20_usize, first in 0..3_usize) {
            for resolution in [Resolution::CENTRES, Resolution::GREY] {
                let found = |capacity: usize| {
                    let mut crossings = Crossings::with_capacity(12, 1, resolution, capacity);
                    crossings.begin(first, 1);
                    segments.iter().for_each(|(segment, is_mirrored)| crossings.add(segment, *is_mirrored));
                    let is_counted = crossings.counts.is_used();
                    let mut spans = Vec::new();
                    crossings.spans(|row, span| spans.push((row, span)));
                    (spans, is_counted, crossings.is_full())
                };
                let (expected, is_counted, _) = found(MAX_CROSSINGS);
                prop_assert!(!is_counted);
                let (spans, _, is_full) = found(capacity);
                prop_assert!(!is_full);
                prop_assert_eq!(spans, expected);
            }
        }
    }
}
