//! The active set: the struts within reach of the plane, in [`Buckets`] of rows. The order within a bucket is that of the file, so sums do
//! not depend on the layer a sweep began with.
//!
//! `sweep` adds and retires struts; `brush` draws its blocks.

use std::ops::Range;

use crate::slice::body::buckets::Buckets;
use crate::solid::{Block, StrutRecord};

/// A bucket is compacted when one in this many of its struts is out of reach. With a quarter, it holds at most a third more struts than
/// needed, and a strut is moved about twice in its life.
const DEAD_SHARE: usize = 4;

/// The struts, in buckets.
#[derive(Debug)]
pub(super) struct ActiveSet {
    place: Buckets,
    buckets: Vec<Bucket>,
    /// Struts within reach: those counted by [`ActiveSet::count`] and those added since.
    alive: usize,
}

/// Blocks of struts. All but the last are full.
#[derive(Debug, Default)]
pub(super) struct Bucket {
    #[allow(
        clippy::vec_box,
        reason = "a list of blocks by value would copy them all when it grows, and reserve room for twice as many"
    )]
    blocks: Vec<Box<Block>>,
    /// Struts out of reach that are still held.
    dead: usize,
}

impl ActiveSet {
    /// An empty set for a picture of `height` rows. Buckets of the lowest level have `min_rows` rows.
    pub(super) fn new(height: usize, min_rows: usize) -> Self {
        let buckets = (0..Buckets::count(height, min_rows)).map(|_| Bucket::default()).collect();
        Self { place: Buckets::new(height, min_rows), buckets, alive: 0 }
    }

    /// Memory for up to `max_active` struts within reach, which may have shares, bytes.
    pub(super) fn memory_bytes(max_active: u64, has_shares: bool, height: usize, min_rows: usize) -> u64 {
        let buckets = Buckets::count(height, min_rows) as u64;
        // The last block of each bucket may be nearly empty.
        let blocks = (max_active / Block::LEN as u64).saturating_add(buckets.min(max_active));
        let blocks = blocks.saturating_add(blocks / (DEAD_SHARE as u64 - 1));
        // A growing list has room for up to twice its length.
        let share_bytes = if has_shares { Block::SHARES_BYTES } else { 0 };
        let block_bytes = (size_of::<Block>() + share_bytes + 2 * size_of::<Box<Block>>()) as u64;
        blocks.saturating_mul(block_bytes).saturating_add(buckets * size_of::<Bucket>() as u64)
    }

    /// Number of struts within reach of the plane last given to [`Bucket::retire`].
    pub(super) fn alive(&self) -> usize {
        self.alive
    }

    /// Adds a strut. The rows are the range that it can reach in any plane; they may lie outside the picture.
    pub(super) fn add(&mut self, record: StrutRecord, rows: [i64; 2]) {
        self.buckets[self.place.of(rows)].push(record);
        self.alive += 1;
    }

    /// All buckets, so that several threads can retire struts.
    pub(super) fn buckets_mut(&mut self) -> impl Iterator<Item = &mut Bucket> {
        self.buckets.iter_mut()
    }

    /// Counts the struts within reach, after [`Bucket::retire`] was called on all buckets.
    pub(super) fn count(&mut self) {
        self.alive = self.buckets.iter().map(|bucket| bucket.len() - bucket.dead).sum();
    }

    /// The blocks that may hold struts that reach these rows. Their order depends on the rows alone.
    pub(super) fn blocks(&self, rows: Range<i64>) -> impl Iterator<Item = &Block> {
        let buckets = self.place.reaching(rows);
        buckets.flat_map(|bucket| self.buckets[bucket].blocks.iter().map(|block| &**block))
    }
}

impl Bucket {
    fn push(&mut self, record: StrutRecord) {
        if !self.blocks.last_mut().is_some_and(|block| block.push(record)) {
            let mut block = Box::<Block>::default();
            block.push(record);
            self.blocks.push(block);
        }
    }

    fn len(&self) -> usize {
        self.blocks.last().map_or(0, |last| (self.blocks.len() - 1) * Block::LEN + last.len())
    }

    /// Retires the struts that end below `z`, quanta. They are removed when they are a quarter of the bucket.
    pub(super) fn retire(&mut self, z: i32) {
        self.dead = self.blocks.iter().map(|block| block.count_below(z)).sum();
        if self.dead > 0 && self.dead * DEAD_SHARE >= self.len() {
            self.compact(z);
        }
    }

    fn compact(&mut self, z: i32) {
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
