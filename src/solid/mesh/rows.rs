//! Segments of a plane to spans of pixels: where each row crosses them, and where the winding number is above 0. `tests/surface` tests it.

use super::section::Segment;

/// Room for at least so many crossings: those of a usual band.
const LEAST_CROSSINGS: usize = 1 << 14;

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
        let scaled = |at: f64, count: u32| if count == 1 { at } else { (at + 0.5) * f64::from(count) - 0.5 };
        [scaled(x, self.columns), scaled(y, self.rows)]
    }
}

/// The crossings of some rows of pixels. It takes a fixed amount of memory.
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
    /// The first row of samples.
    first: f64,
    is_full: bool,
}

impl Crossings {
    /// For up to `rows` rows of `width` pixels, and `facets` facets that may cross the same row.
    pub(crate) fn new(width: usize, rows: usize, facets: usize, resolution: Resolution) -> Self {
        let capacity = Self::capacity(facets, resolution);
        Self {
            resolution,
            width: width as u32 * resolution.columns,
            capacity,
            found: Vec::with_capacity(capacity),
            keys: Vec::with_capacity(capacity),
            ends: Vec::with_capacity(rows * resolution.rows as usize),
            first: 0.0,
            is_full: false,
        }
    }

    /// Its memory, bytes.
    pub(crate) fn bytes(rows: usize, facets: usize, resolution: Resolution) -> u64 {
        let keys = Self::capacity(facets, resolution).saturating_mul(size_of::<[u32; 2]>() + size_of::<u32>());
        keys.saturating_add(rows * resolution.rows as usize * size_of::<u32>()) as u64
    }

    /// Room for all crossings of one row of pixels.
    fn capacity(facets: usize, resolution: Resolution) -> usize {
        facets.saturating_mul(resolution.rows as usize).max(LEAST_CROSSINGS)
    }

    /// Begins `count` rows of pixels from row `first` on.
    pub(crate) fn begin(&mut self, first: usize, count: usize) {
        let rows = self.resolution.rows as usize;
        self.first = (first * rows) as f64;
        self.found.clear();
        self.ends.clear();
        self.ends.resize(count * rows, 0);
        self.is_full = false;
    }

    /// Adds a segment. `is_mirrored`: the solid lies to its right.
    pub(crate) fn add(&mut self, segment: &Segment, is_mirrored: bool) {
        let [from, to] = [segment.from, segment.to].map(|end| self.resolution.samples(end));
        let goes_up = from[1] < to[1];
        let [low, high] = if goes_up { [from, to] } else { [to, from] };
        // The row at its upper end belongs to the next segment. The casts saturate.
        let rows = [low, high].map(|end| (end[1] - self.first).ceil().max(0.0) as usize);
        let slope = (high[0] - low[0]) / (high[1] - low[1]);
        let falls = u32::from(goes_up != is_mirrored);
        for row in rows[0]..rows[1].min(self.ends.len()) {
            if self.found.len() == self.capacity {
                self.is_full = true;
                return;
            }
            let at = low[0] + (self.first + row as f64 - low[1]) * slope;
            let sample = (at.ceil().max(0.0) as u32).min(self.width);
            self.ends[row] += 1;
            self.found.push([row as u32, sample << 1 | falls]);
        }
    }

    /// Whether crossings were left out because there was no room. Then begin again with fewer rows: one row of pixels has room.
    pub(crate) fn is_full(&self) -> bool {
        self.is_full
    }

    /// Calls `fill` with each row of pixels, counted from the first, and each span of samples in it whose winding number is above 0. A row of
    /// pixels may have several rows of samples.
    pub(crate) fn spans(&mut self, mut fill: impl FnMut(usize, std::ops::Range<u32>)) {
        self.sort();
        let mut begin_of_row = 0;
        for (row, end_of_row) in self.ends.iter().enumerate() {
            let (mut winding, mut begin) = (0, 0);
            for key in &self.keys[begin_of_row..*end_of_row as usize] {
                let sample = key >> 1;
                let before = winding;
                winding += 1 - 2 * (key & 1) as i32;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The spans of squares, each of one height.
    fn spans(squares: &[[f64; 3]], resolution: Resolution) -> Vec<(usize, std::ops::Range<u32>)> {
        let mut crossings = Crossings::new(20, 8, 8, resolution);
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
    fn too_many_crossings_are_told() {
        let mut crossings = Crossings::new(20, 4096, 8, Resolution::CENTRES);
        let wall = Segment { from: [3.0, -1.0], to: [3.0, 5000.0] };
        crossings.begin(0, 4096);
        for _ in 0..20 {
            crossings.add(&wall, false);
        }
        assert!(crossings.is_full());
        crossings.begin(0, 1);
        for _ in 0..20 {
            crossings.add(&wall, false);
        }
        assert!(!crossings.is_full());
    }
}
