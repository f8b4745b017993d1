//! Reads the primitives of a body in ascending order while the plane rises: several chunks at once, one a thread. `lattice/sweep.rs` and
//! `surface/sweep.rs` use it.

use super::source::{BodyPrimitive, ChunkSource};
use crate::slice::SliceError;
use crate::slice::workers::Workers;

/// What has been read ahead.
pub(super) struct Feed<P> {
    /// Chunks that were read at once, one per thread. The primitives from `slot` and `next` on are still to be taken.
    slots: Vec<Slot<P>>,
    filled: usize,
    slot: usize,
    next: usize,
    next_chunk: usize,
}

/// A chunk that was read.
struct Slot<P> {
    chunk: usize,
    primitives: Vec<P>,
    problem: Option<anyhow::Error>,
}

impl<P: BodyPrimitive> Feed<P> {
    /// A feed that begins with the first chunk of a source, and reads with `threads` threads.
    pub(super) fn new(source: &dyn ChunkSource<P>, threads: usize) -> Self {
        let most = source.chunk_primitives();
        let slot = || Slot { chunk: 0, primitives: Vec::with_capacity(most), problem: None };
        Self { slots: (0..threads).map(|_| slot()).collect(), filled: 0, slot: 0, next: 0, next_chunk: 0 }
    }

    /// Its memory, bytes.
    pub(super) fn memory_bytes(source: &dyn ChunkSource<P>, threads: usize) -> u64 {
        ((source.chunk_primitives() * size_of::<P>()) as u64).saturating_mul(threads as u64)
    }

    /// Hands on the primitives that reach from `z[0]` to `z[1]`, quanta, or begin below, and the number of their chunk. Chunks that end below
    /// `z[0]` are passed over. `take` returns false if a primitive begins above `z[1]`; it is handed on again the next time.
    ///
    /// # Errors
    /// If a chunk cannot be read, or that of `take`.
    pub(super) fn take(
        &mut self,
        source: &dyn ChunkSource<P>,
        z: [f64; 2],
        workers: &Workers,
        mut take: impl FnMut(&P, usize) -> Result<bool, SliceError>,
    ) -> Result<(), SliceError> {
        loop {
            while self.slot < self.filled {
                let slot = &self.slots[self.slot];
                while let Some(primitive) = slot.primitives.get(self.next) {
                    if !take(primitive, slot.chunk)? {
                        return Ok(());
                    }
                    self.next += 1;
                }
                self.slot += 1;
                self.next = 0;
            }
            if !self.read(source, z, workers)? {
                return Ok(());
            }
        }
    }

    /// Reads the next chunks that reach `z`. Returns `false` if no chunk begins below its upper end.
    fn read(
        &mut self,
        source: &dyn ChunkSource<P>,
        [low, high]: [f64; 2],
        workers: &Workers,
    ) -> Result<bool, SliceError> {
        (self.slot, self.filled) = (0, 0);
        while self.filled < self.slots.len() && self.next_chunk < source.chunk_count() {
            let span = source.chunk_span(self.next_chunk);
            if f64::from(span.lowest_z) > high {
                break;
            }
            if f64::from(span.highest_z) >= low {
                self.slots[self.filled].chunk = self.next_chunk;
                self.filled += 1;
            }
            self.next_chunk += 1;
        }
        workers.each(self.slots[..self.filled].iter_mut(), |slot| {
            slot.problem = source.read_chunk(slot.chunk, &mut slot.primitives).err();
        });
        let problem = self.slots[..self.filled].iter_mut().find_map(|slot| slot.problem.take());
        problem.map_or(Ok(self.filled > 0), |problem| Err(SliceError::Source(problem)))
    }
}
