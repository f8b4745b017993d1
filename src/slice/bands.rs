//! Which active struts a band of rows needs, in file order.
//!
//! A counting sort by bands. A strut may reach many bands, so the lists are made for as many bands at a time as fit a bounded
//! number of entries; a single band never needs more than one entry a strut.

use crate::solid::{Grid, Shape};

/// Entries a strut: most reach one to four bands. Fewer would only mean more rounds.
const ENTRIES_PER_STRUT: usize = 4;

/// Lists of struts for bands of rows.
#[derive(Debug)]
pub(super) struct Bands {
    rows_per_band: usize,
    /// Rows above and below a band that it must know as well.
    halo: i32,
    count: usize,
    /// For each active strut the first band and the one after its last; equal where it reaches none.
    reached: Vec<[u32; 2]>,
    /// Entries of each band.
    lengths: Vec<usize>,
    /// Where each band's list begins in `entries`, for the bands of the round; then one more: its end.
    starts: Vec<usize>,
    entries: Vec<u32>,
    first: usize,
}

impl Bands {
    pub(super) fn new(height: usize, rows_per_band: usize, halo: usize) -> Self {
        let count = height.div_ceil(rows_per_band);
        Self {
            rows_per_band,
            halo: halo as i32,
            count,
            reached: Vec::new(),
            lengths: vec![0; count],
            starts: Vec::with_capacity(count + 1),
            entries: Vec::new(),
            first: 0,
        }
    }

    /// Bytes needed for `peak_active` struts at most.
    pub(super) fn memory_bytes(peak_active: u64, height: usize, rows_per_band: usize) -> u64 {
        let strut = (size_of::<[u32; 2]>() + ENTRIES_PER_STRUT * size_of::<u32>()) as u64;
        peak_active.saturating_mul(strut).saturating_add((height.div_ceil(rows_per_band) as u64 + 1) * 16)
    }

    /// Takes the struts of a new layer; rounds begin at band 0.
    pub(super) fn begin_layer<S: Shape>(&mut self, active: &[S], grid: &Grid, z: f64) {
        self.lengths.fill(0);
        self.reached.clear();
        self.reached.reserve_exact(active.len());
        let height = self.count * self.rows_per_band;
        for shape in active {
            let range = shape.row_range(grid, z).unwrap_or([0, -1]);
            let first = (range[0].saturating_sub(self.halo)).max(0) as usize;
            let end = ((range[1].saturating_add(1 + self.halo)).max(0) as usize).min(height);
            let bands =
                if first < end { [first / self.rows_per_band, (end - 1) / self.rows_per_band + 1] } else { [0, 0] };
            for length in &mut self.lengths[bands[0]..bands[1]] {
                *length += 1;
            }
            self.reached.push(bands.map(|band| band as u32));
        }
        self.first = 0;
        self.starts.clear();
    }

    /// Makes the lists of the next bands; `None` after the last.
    pub(super) fn next_round(&mut self) -> Option<std::ops::Range<usize>> {
        self.first += self.starts.len().saturating_sub(1);
        if self.first == self.count {
            return None;
        }
        let room = self.reached.len() * ENTRIES_PER_STRUT;
        self.starts.clear();
        self.starts.push(0);
        let mut total = 0;
        for length in &self.lengths[self.first..] {
            if total + length > room {
                break;
            }
            total += length;
            self.starts.push(total);
        }
        let round = self.first..self.first + self.starts.len() - 1;
        self.fill(&round, total);
        Some(round)
    }

    fn fill(&mut self, round: &std::ops::Range<usize>, total: usize) {
        if self.entries.len() < total {
            self.entries.reserve_exact(total - self.entries.len());
            self.entries.resize(total, 0);
        }
        // `lengths` of the round serve as write positions and are put right again at the end.
        self.lengths[round.clone()].copy_from_slice(&self.starts[..round.len()]);
        for (strut, [first, end]) in self.reached.iter().enumerate() {
            let (first, end) = ((*first as usize).max(round.start), (*end as usize).min(round.end));
            for band in first..end {
                self.entries[self.lengths[band]] = strut as u32;
                self.lengths[band] += 1;
            }
        }
        for (index, band) in round.clone().enumerate() {
            self.lengths[band] = self.starts[index + 1] - self.starts[index];
        }
    }

    /// The struts of a band of the current round, in file order.
    pub(super) fn struts(&self, band: usize) -> &[u32] {
        let index = band - self.first;
        &self.entries[self.starts[index]..self.starts[index + 1]]
    }
}
