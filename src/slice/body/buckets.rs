//! Buckets of rows, so that each band quickly finds the primitives that may reach it. `lattice/active.rs` and `surface/active.rs` use them.
//!
//! There are several levels of buckets; the buckets of each level are twice as high as those of the level below. A primitive is in exactly
//! one bucket: on the lowest level whose buckets are at least as high as the range of rows that the primitive can ever reach, and there in
//! the bucket of the first of these rows. So a band finds all its primitives in at most two or three buckets of each level.

use std::ops::Range;

use crate::slice::SlicePlan;

/// Which bucket holds what.
#[derive(Debug)]
pub(super) struct Buckets {
    levels: Vec<Level>,
}

/// Buckets of one height.
#[derive(Debug)]
struct Level {
    rows: i64,
    buckets: Range<usize>,
}

impl Buckets {
    /// For a picture of `height` rows. Buckets of the lowest level have `min_rows` rows.
    pub(super) fn new(height: usize, min_rows: usize) -> Self {
        let mut levels = Vec::new();
        let mut first = 0;
        for (rows, count) in level_sizes(height, min_rows) {
            levels.push(Level { rows: rows as i64, buckets: first..first + count });
            first += count;
        }
        Self { levels }
    }

    /// Number of buckets of such a picture.
    pub(super) fn count(height: usize, min_rows: usize) -> usize {
        level_sizes(height, min_rows).map(|(_, count)| count).sum()
    }

    /// The bucket of a primitive. The rows are the range that it can reach in any plane; they may lie outside the picture.
    pub(super) fn of(&self, [first_row, last_row]: [i64; 2]) -> usize {
        let fits = |level: &&Level| level.rows > last_row.saturating_sub(first_row);
        self.levels.iter().find(fits).or(self.levels.last()).map_or(0, |level| level.bucket(first_row))
    }

    /// The buckets of primitives that may reach these rows.
    pub(super) fn reaching(&self, rows: Range<i64>) -> impl Iterator<Item = usize> {
        self.levels
            .iter()
            .flat_map(move |level| level.bucket(rows.start - level.rows + 1)..level.bucket(rows.end - 1) + 1)
    }
}

/// Height in rows and number of the buckets of each level. The last level has one bucket, for primitives that reach more rows than the
/// buckets of all other levels have.
fn level_sizes(height: usize, min_rows: usize) -> impl Iterator<Item = (usize, usize)> {
    let mut next = Some(min_rows);
    std::iter::from_fn(move || {
        let rows = next?;
        let count = height.div_ceil(rows).max(1);
        next = (count > 1).then_some(2 * rows);
        Some((rows, count))
    })
}

impl Level {
    fn bucket(&self, row: i64) -> usize {
        let last = self.buckets.len() as i64 - 1;
        self.buckets.start + row.div_euclid(self.rows).clamp(0, last) as usize
    }
}

/// Converts y in quanta to rows of the picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rows {
    row_0: f64,
    rows_per_quantum: f64,
    /// Rows that a primitive may reach beyond its points.
    reach: f64,
}

impl Rows {
    /// For primitives that reach `reach_um` beyond their points.
    pub(super) fn of(plan: &SlicePlan, quantum_um: f64, reach_um: f64) -> Self {
        let dy = plan.step_um()[1];
        Self {
            row_0: plan.origin_um[1] / dy,
            rows_per_quantum: quantum_um / dy,
            // Rows of samples in grey, and shifted rows, lie up to half a row from the middle of a row; the other half row is for
            // rounding errors.
            reach: reach_um / dy.abs() + 1.0,
        }
    }

    /// The rows that a primitive can reach in any plane. `ys`: the y of its points.
    pub(super) fn reached<const N: usize>(self, ys: [f64; N]) -> [i64; 2] {
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        for y in ys {
            let row = y * self.rows_per_quantum - self.row_0;
            (low, high) = (low.min(row), high.max(row));
        }
        [floor(low - self.reach), -floor(-high - self.reach)]
    }
}

/// The next whole number below. `f64::floor` is a function call on processors without SSE 4.1.
fn floor(value: f64) -> i64 {
    // The cast saturates.
    let whole = value as i64;
    whole.saturating_sub(i64::from(whole as f64 > value))
}
