//! Crossings of one row of pixels as counts: by how much the winding number changes at each sample. So any number of crossings takes the
//! same memory. `rows` uses it where a row has more of them than it keeps, and its unit tests compare both ways.

use std::ops::Range;

/// The changes of one row of pixels, which may have several rows of samples.
#[derive(Debug)]
pub(super) struct Counts {
    /// Row by row. Each has a place more than samples, for what changes behind the last.
    changes: Vec<i32>,
    /// Places of a row.
    stride: usize,
    rows: usize,
    is_used: bool,
}

impl Counts {
    /// For `rows` rows of `width` samples. The memory is taken at once, but not touched before it is used.
    pub(super) fn new(width: u32, rows: usize) -> Self {
        let stride = width as usize + 1;
        Self { changes: Vec::with_capacity(stride * rows), stride, rows, is_used: false }
    }

    /// Its memory, bytes.
    pub(super) fn bytes(width: u32, rows: usize) -> u64 {
        ((width as usize + 1) * rows * size_of::<i32>()) as u64
    }

    /// Whether anything was counted.
    pub(super) fn is_used(&self) -> bool {
        self.is_used
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.is_used = false;
    }

    /// Counts a change of the winding number at a sample of a row.
    pub(super) fn add(&mut self, row: usize, sample: u32, change: i32) {
        if !self.is_used {
            self.changes.clear();
            self.changes.resize(self.stride * self.rows, 0);
            self.is_used = true;
        }
        self.changes[row * self.stride + sample as usize] += change;
    }

    /// Calls `fill` with each span of samples whose winding number is above 0, row by row.
    pub(super) fn spans(&self, mut fill: impl FnMut(Range<u32>)) {
        for row in self.changes.chunks_exact(self.stride) {
            let (mut winding, mut begin) = (0, 0);
            for (sample, change) in row.iter().enumerate().filter(|(_, change)| **change != 0) {
                let before = winding;
                winding += change;
                match (before > 0, winding > 0) {
                    (false, true) => begin = sample as u32,
                    (true, false) => fill(begin..sample as u32),
                    _ => {}
                }
            }
        }
    }
}
