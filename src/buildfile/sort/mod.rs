//! External sort: sorts more primitives than memory holds, as sorted runs in one temporary file that are then merged.
//!
//! The temporary file never has a name, so nothing stays behind, however the process ends. Several threads may sort at once, each with
//! its own [`Sorter`] of a team that shares the file. The order is total, so the result does not depend on which run holds which
//! primitive. The tests below sort triangles.

mod merge;
mod spill;

use std::io;
use std::path::Path;
use std::sync::Arc;

pub(super) use self::merge::Merge;
use self::spill::Spill;
pub(super) use self::spill::check_free_space;
use super::primitive::{Key, Sortable};

/// Smallest buffer for each run of a merge: with less, seeking takes longer than reading. It limits how many runs are merged at once.
const MIN_RUN_BUFFER_BYTES: usize = 16 << 10;

/// Largest buffer for each run of a merge: more gains nothing.
const MAX_RUN_BUFFER_BYTES: usize = 1 << 20;

/// Keys that a buffer has room for at first: 128 KiB of struts.
const FIRST_KEYS: usize = 4096;

/// Sorts primitives into file order within a limit of memory.
pub(super) struct Sorter<P: Sortable> {
    spill: Arc<Spill>,
    /// Memory of the whole team.
    memory_bytes: usize,
    buffer: Vec<P::Key>,
    capacity: usize,
}

impl<P: Sortable> Sorter<P> {
    /// A sorter whose buffers take at most `memory_bytes` (at least room for four runs). Runs are written to `directory`.
    pub(super) fn new(directory: &Path, memory_bytes: u64) -> Self {
        Self::alone(Arc::new(Spill::new(directory)), memory_bytes, 1)
    }

    /// Sorters for `count` threads that take `memory_bytes` together; [`finish`] joins what they sort.
    pub(super) fn team(directory: &Path, memory_bytes: u64, count: usize) -> Vec<Self> {
        let spill = Arc::new(Spill::new(directory));
        (0..count).map(|_| Self::alone(Arc::clone(&spill), memory_bytes, count)).collect()
    }

    fn alone(spill: Arc<Spill>, memory_bytes: u64, count: usize) -> Self {
        let memory_bytes = memory_size(memory_bytes);
        Self { spill, memory_bytes, buffer: Vec::new(), capacity: capacity::<P::Key>(memory_bytes, count) }
    }

    /// Temporary space that the team has taken, bytes.
    pub(super) fn spilled_bytes(&self) -> u64 {
        self.spill.bytes()
    }

    /// Halves its memory.
    ///
    /// # Errors
    /// If a run cannot be written.
    pub(super) fn halve(&mut self) -> io::Result<()> {
        self.capacity = (self.capacity / 2).max(1);
        if self.buffer.len() > self.capacity {
            self.spill_run()?;
        }
        self.buffer.shrink_to(self.capacity);
        Ok(())
    }

    /// Adds one primitive.
    ///
    /// # Errors
    /// If a run cannot be written.
    pub(super) fn push(&mut self, primitive: P) -> io::Result<()> {
        if self.buffer.len() == self.capacity {
            self.spill_run()?;
        }
        if self.buffer.len() == self.buffer.capacity() {
            // In steps, because most parts are small; a large block grows by moving its pages, not its bytes.
            let wanted = (2 * self.buffer.len()).max(FIRST_KEYS).min(self.capacity);
            self.buffer.reserve_exact(wanted - self.buffer.len());
        }
        self.buffer.push(primitive.key());
        Ok(())
    }

    /// All primitives in file order.
    ///
    /// # Errors
    /// If runs cannot be written or read.
    pub(super) fn finish(self) -> io::Result<Merge<P>> {
        finish(vec![self], &mut |_, _| {})
    }

    /// Sorts what this sorter holds, and writes it if any sorter of the team has written a run.
    fn settle(&mut self) -> io::Result<()> {
        if self.spill.is_used() {
            self.spill_run()?;
            self.buffer = Vec::new();
        } else {
            self.buffer.sort_unstable();
        }
        Ok(())
    }

    fn spill_run(&mut self) -> io::Result<()> {
        self.buffer.sort_unstable();
        self.spill.write_run(&self.buffer)?;
        self.buffer.clear();
        Ok(())
    }
}

/// All primitives of a team in file order. If there are more runs than can be merged at once, they are first merged in several passes:
/// `progress` takes the bytes merged so far, and the bytes of all passes.
///
/// # Errors
/// If runs cannot be written or read.
pub(super) fn finish<P: Sortable>(
    mut team: Vec<Sorter<P>>,
    progress: &mut dyn FnMut(u64, u64),
) -> io::Result<Merge<P>> {
    if let [alone] = team.as_mut_slice() {
        // Without a thread: `generate` sorts many small layers, and starting a thread for each takes longer than sorting it.
        alone.settle()?;
    } else {
        settle_all(&mut team)?;
    }
    let Some(Sorter { spill, memory_bytes, .. }) = team.first() else { return Ok(Merge::of_memory(Vec::new())) };
    if !spill.is_used() {
        return Ok(Merge::of_memory(team.into_iter().map(|sorter| sorter.buffer).collect()));
    }
    let (mut spill, memory_bytes) = (Arc::clone(spill), *memory_bytes);
    drop(team);
    let fan_in = fan_in(memory_bytes);
    let (mut before, mut total) = (0, None);
    loop {
        let (file, runs) = spill.written()?;
        let bytes = runs.last().map_or(0, |run| run.end);
        let total = *total.get_or_insert(bytes * passes(runs.len(), fan_in));
        let buffer_bytes =
            (memory_bytes / (runs.len().min(fan_in) + 1)).clamp(MIN_RUN_BUFFER_BYTES, MAX_RUN_BUFFER_BYTES);
        if runs.len() <= fan_in {
            return Merge::of_file(file, &runs, buffer_bytes);
        }
        let next = spill.successor();
        for group in runs.chunks(fan_in) {
            next.append(&mut Merge::<P>::of_file(Arc::clone(&file), group, buffer_bytes)?, &mut |done| {
                progress(before + done, total);
            })?;
        }
        before += bytes;
        spill = Arc::new(next);
    }
}

/// [`Sorter::settle`] of all, each on its own thread.
fn settle_all<P: Sortable>(team: &mut [Sorter<P>]) -> io::Result<()> {
    std::thread::scope(|scope| {
        let settling: Vec<_> = team.iter_mut().map(|sorter| scope.spawn(|| sorter.settle())).collect();
        settling
            .into_iter()
            .try_for_each(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// Temporary space that sorting `count` primitives takes at most, bytes: 0 if they fit the memory of one sorter of the team. A merge
/// pass over all runs needs room for two copies.
pub(super) fn spill_bytes<P: Sortable>(count: u64, memory_bytes: u64, team: usize) -> u64 {
    let capacity = capacity::<P::Key>(memory_size(memory_bytes), team) as u64;
    let runs = usize::try_from(count.div_ceil(capacity)).unwrap_or(usize::MAX);
    // Each sorter of the team may leave one run that is not full.
    match runs.saturating_add(team - 1) {
        _ if runs <= 1 => 0,
        runs if runs <= fan_in(memory_size(memory_bytes)) => count.saturating_mul(P::Key::BYTES as u64),
        _ => count.saturating_mul(2 * P::Key::BYTES as u64),
    }
}

/// Memory that a team may take, bytes.
fn memory_size(memory_bytes: u64) -> usize {
    usize::try_from(memory_bytes).unwrap_or(usize::MAX).max(4 * MIN_RUN_BUFFER_BYTES)
}

/// Keys that each sorter of a team may hold.
fn capacity<K: Key>(memory_bytes: usize, team: usize) -> usize {
    (memory_bytes / team / size_of::<K>()).max(1)
}

/// Runs that can be merged at once. One more buffer holds bytes of the file until they are decoded.
fn fan_in(memory_bytes: usize) -> usize {
    memory_bytes / MIN_RUN_BUFFER_BYTES - 1
}

/// Merge passes over so many runs before the last one.
fn passes(mut runs: usize, fan_in: usize) -> u64 {
    let mut passes = 0;
    while runs > fan_in {
        runs = runs.div_ceil(fan_in);
        passes += 1;
    }
    passes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::buildfile::model::Triangle;
    use crate::buildfile::primitive::triangle::triangles;

    /// In memory, merged once, and merged in several passes.
    #[test]
    fn a_second_kind_of_primitive_is_sorted_in_memory_and_out_of_core() {
        let (_, unsorted) = triangles(30_000, 7);
        let mut expected = unsorted.clone();
        expected.sort_by_key(Sortable::key);
        for (memory_bytes, spilled) in [(16 << 20, 0), (800 << 10, 72), (64 << 10, 144)] {
            let directory = tempfile::tempdir().expect("temporary directory");
            let mut team = Sorter::<Triangle>::team(directory.path(), memory_bytes, 3);
            for (number, triangle) in unsorted.iter().enumerate() {
                team[number % 3].push(*triangle).expect("there is room");
            }
            let mut joined = 0;
            let sorted = finish(team, &mut |done, total| joined = total - done).expect("there is room");
            assert!(sorted.map(|triangle| triangle.expect("is there")).eq(expected.iter().copied()));
            assert_eq!(joined, 0, "all passes were reported to their end");
            assert_eq!(spill_bytes::<Triangle>(30_000, memory_bytes, 3), 30_000 * spilled);
        }
    }
}
