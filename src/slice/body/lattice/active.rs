//! The active set: struts within reach of the plane, where the bands of a picture find them.
//!
//! Buckets of rows hold them, on levels of doubling height. A strut stands in one bucket only, of the lowest level whose
//! buckets are as high as the rows it can ever reach, by the first of those rows; so a band finds all it needs in at most
//! two or three buckets a level. Order within a bucket is that of the file: sums do not depend on where a sweep began.

use std::ops::Range;

use crate::solid::{Block, Record};

/// A bucket is tidied when this share of it is out of reach: 1/4 keeps a third more than needed at most, and moves a strut
/// about twice in its life.
const DEAD_SHARE: usize = 4;

/// Struts in buckets.
#[derive(Debug)]
pub(super) struct ActiveSet {
    levels: Vec<Level>,
    buckets: Vec<Bucket>,
    /// Struts within reach, as of the last [`ActiveSet::retire`] and since.
    alive: usize,
}

/// Buckets of one height.
#[derive(Debug)]
struct Level {
    rows: i64,
    buckets: Range<usize>,
}

/// Blocks of struts, all full but the last.
#[derive(Debug, Default)]
pub(super) struct Bucket {
    #[allow(
        clippy::vec_box,
        reason = "a growing list would hold each block twice for a moment, and twice the room after"
    )]
    blocks: Vec<Box<Block>>,
    dead: usize,
}

impl ActiveSet {
    /// For a picture of `height` rows, with buckets of `least_rows` on the lowest level.
    pub(super) fn new(height: usize, least_rows: usize) -> Self {
        let mut levels = Vec::new();
        let mut first = 0;
        for (rows, count) in level_sizes(height, least_rows) {
            levels.push(Level { rows: rows as i64, buckets: first..first + count });
            first += count;
        }
        Self { levels, buckets: (0..first).map(|_| Bucket::default()).collect(), alive: 0 }
    }

    /// Bytes for `most` struts within reach at once.
    pub(super) fn memory_bytes(most: u64, height: usize, least_rows: usize) -> u64 {
        let buckets = level_sizes(height, least_rows).map(|(_, count)| count as u64).sum::<u64>();
        // Each bucket's last block may be nearly empty.
        let blocks = (most / Block::LEN as u64).saturating_add(buckets.min(most));
        let blocks = blocks.saturating_add(blocks / (DEAD_SHARE as u64 - 1));
        // A growing list of blocks has twice the room it needs.
        let block_bytes = (size_of::<Block>() + 2 * size_of::<Box<Block>>()) as u64;
        blocks.saturating_mul(block_bytes).saturating_add(buckets * size_of::<Bucket>() as u64)
    }

    /// Struts within reach of the plane last given to the buckets' [`Bucket::retire`].
    pub(super) fn alive(&self) -> usize {
        self.alive
    }

    /// Adds a strut that can reach the given rows at some plane; they may lie outside the picture.
    pub(super) fn add(&mut self, record: Record, [first_row, last_row]: [i64; 2]) {
        let fits = |level: &&Level| level.rows > last_row.saturating_sub(first_row);
        let Some(level) = self.levels.iter().find(fits).or(self.levels.last()) else { return };
        let bucket = level.bucket(first_row);
        self.buckets[bucket].push(record);
        self.alive += 1;
    }

    /// All buckets, to be tidied side by side.
    pub(super) fn buckets_mut(&mut self) -> impl Iterator<Item = &mut Bucket> {
        self.buckets.iter_mut()
    }

    /// Counts anew after the buckets were tidied.
    pub(super) fn count(&mut self) {
        self.alive = self.buckets.iter().map(|bucket| bucket.len() - bucket.dead).sum();
    }

    /// The blocks that may hold struts reaching these rows, in an order that depends on the rows alone.
    pub(super) fn blocks(&self, rows: Range<i64>) -> impl Iterator<Item = &Block> {
        let buckets = self
            .levels
            .iter()
            .flat_map(move |level| level.bucket(rows.start - level.rows + 1)..level.bucket(rows.end - 1) + 1);
        buckets.flat_map(|bucket| self.buckets[bucket].blocks.iter().map(|block| &**block))
    }
}

/// Height in rows and number of the buckets of each level; the last has one, for whatever is higher than all others.
fn level_sizes(height: usize, least_rows: usize) -> impl Iterator<Item = (usize, usize)> {
    let mut next = Some(least_rows);
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

impl Bucket {
    fn push(&mut self, record: Record) {
        if !self.blocks.last_mut().is_some_and(|block| block.push(record)) {
            let mut block = Box::<Block>::default();
            block.push(record);
            self.blocks.push(block);
        }
    }

    fn len(&self) -> usize {
        self.blocks.last().map_or(0, |last| (self.blocks.len() - 1) * Block::LEN + last.len())
    }

    /// Lets struts go that end below `z`, quanta; not at once, but before they are a quarter of the bucket.
    pub(super) fn retire(&mut self, z: i32) {
        self.dead = self.blocks.iter().map(|block| block.count_below(z)).sum();
        if self.dead > 0 && self.dead * DEAD_SHARE >= self.len() {
            self.tidy(z);
        }
    }

    fn tidy(&mut self, z: i32) {
        let mut kept = 0;
        for from in 0..self.len() {
            let record = self.blocks[from / Block::LEN].get(from % Block::LEN);
            if record.b[2] >= z {
                self.blocks[kept / Block::LEN].set(kept % Block::LEN, record);
                kept += 1;
            }
        }
        self.blocks.truncate(kept.div_ceil(Block::LEN));
        if let Some(last) = self.blocks.last_mut() {
            last.truncate((kept - 1) % Block::LEN + 1);
        }
        self.dead = 0;
    }
}
