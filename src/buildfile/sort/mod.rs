//! Sorting more struts than memory holds: sorted runs in one nameless temporary file, then merged.
//!
//! The temporary file has no name from the start, so nothing stays behind whatever ends the process. Several threads may sort
//! at once, each with its own [`Sorter`] of a team that shares the file; which run holds which strut does not change the
//! result, as the order is total.

mod key;
mod merge;

use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use self::key::SortKey;
pub(super) use self::merge::Merge;
use crate::buildfile::model::Strut;
use crate::text::size_text;

/// Least buffer for each run of a merge: below it, seeking costs more than reading. Sets how many runs are merged at once.
const RUN_BUFFER_BYTES: usize = 16 << 10;

/// Largest buffer for each run: beyond it nothing is gained.
const RUN_BUFFER_LIMIT_BYTES: usize = 1 << 20;

/// Records turned into bytes at once when a run is written.
const WRITE_RECORDS: usize = 2048;

/// Records a buffer begins with: 128 KiB.
const FIRST_RECORDS: usize = 4096;

/// Sorts struts into file order within a number of bytes.
pub(super) struct Sorter {
    spill: Arc<Spill>,
    /// Bytes of the whole team.
    memory_bytes: usize,
    buffer: Vec<SortKey>,
    capacity: usize,
}

impl Sorter {
    /// A sorter whose buffers take at most `memory_bytes` (at least room for four runs); spills go to `directory`.
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
        Self { spill, memory_bytes, buffer: Vec::new(), capacity: capacity(memory_bytes, count) }
    }

    /// Bytes of temporary space that the team has taken.
    pub(super) fn spilled_bytes(&self) -> u64 {
        self.spill.lock().ranges.last().map_or(0, |range| range.end)
    }

    /// Adds one strut, whose radii are at most [`crate::solid::LARGEST_RADIUS`].
    ///
    /// # Errors
    /// Where a run cannot be written.
    pub(super) fn push(&mut self, strut: Strut) -> io::Result<()> {
        if self.buffer.len() == self.capacity {
            self.spill_run()?;
        }
        if self.buffer.len() == self.buffer.capacity() {
            // In steps, as most parts are small; a large block grows by moving its pages, not its bytes.
            let wanted = (2 * self.buffer.len()).max(FIRST_RECORDS).min(self.capacity);
            self.buffer.reserve_exact(wanted - self.buffer.len());
        }
        self.buffer.push(SortKey::of(&strut));
        Ok(())
    }

    /// All struts in file order.
    ///
    /// # Errors
    /// Where runs cannot be written or read.
    pub(super) fn finish(self) -> io::Result<Merge> {
        finish(vec![self], &mut |_, _| {})
    }

    /// Sorts what this sorter holds, and writes it where any of the team has written a run.
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

/// All struts of a team in file order. Where there are more runs than can be merged at once, they are merged in several
/// passes first: `progress` takes the bytes merged so far and in all passes.
///
/// # Errors
/// Where runs cannot be written or read.
pub(super) fn finish(mut team: Vec<Sorter>, progress: &mut dyn FnMut(u64, u64)) -> io::Result<Merge> {
    if let [alone] = team.as_mut_slice() {
        // Without a thread: whoever sorts many small parts would wait for its start each time.
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
            (memory_bytes / (runs.len().min(fan_in) + 1)).clamp(RUN_BUFFER_BYTES, RUN_BUFFER_LIMIT_BYTES);
        if runs.len() <= fan_in {
            return Merge::of_file(file, &runs, buffer_bytes);
        }
        let next = Spill::new(&spill.directory);
        for group in runs.chunks(fan_in) {
            next.append(&mut Merge::of_file(Arc::clone(&file), group, buffer_bytes)?, &mut |done| {
                progress(before + done, total);
            })?;
        }
        before += bytes;
        spill = Arc::new(next);
    }
}

/// [`Sorter::settle`] of all, side by side.
fn settle_all(team: &mut [Sorter]) -> io::Result<()> {
    std::thread::scope(|scope| {
        let settling: Vec<_> = team.iter_mut().map(|sorter| scope.spawn(|| sorter.settle())).collect();
        settling
            .into_iter()
            .try_for_each(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// Bytes of temporary space that sorting so many struts takes at most: 0 where they fit the memory of any one of the team.
/// A pass over all runs needs room for them twice.
pub(super) fn spill_bytes(struts: u64, memory_bytes: u64, team: usize) -> u64 {
    let capacity = capacity(memory_size(memory_bytes), team) as u64;
    let runs = usize::try_from(struts.div_ceil(capacity)).unwrap_or(usize::MAX);
    // Each of the team may leave one run that is not full.
    match runs.saturating_add(team - 1) {
        _ if runs <= 1 => 0,
        runs if runs <= fan_in(memory_size(memory_bytes)) => struts.saturating_mul(SortKey::BYTES as u64),
        _ => struts.saturating_mul(2 * SortKey::BYTES as u64),
    }
}

/// The bytes a team may take.
fn memory_size(memory_bytes: u64) -> usize {
    usize::try_from(memory_bytes).unwrap_or(usize::MAX).max(4 * RUN_BUFFER_BYTES)
}

/// Records that each of a team may hold.
fn capacity(memory_bytes: usize, team: usize) -> usize {
    (memory_bytes / team / size_of::<SortKey>()).max(1)
}

/// Runs that can be merged at once. One buffer more takes bytes from the file before they are records.
fn fan_in(memory_bytes: usize) -> usize {
    memory_bytes / RUN_BUFFER_BYTES - 1
}

/// Passes over so many runs before they can be merged at once.
fn passes(mut runs: usize, fan_in: usize) -> u64 {
    let mut passes = 0;
    while runs > fan_in {
        runs = runs.div_ceil(fan_in);
        passes += 1;
    }
    passes
}

/// Refuses before writing where `bytes` do not fit the file system of `directory`.
///
/// # Errors
/// Says how much is needed and how much is free.
pub(super) fn check_free_space(directory: &Path, bytes: u64) -> io::Result<()> {
    let free = crate::disk::free_bytes(directory)?;
    if free >= bytes {
        return Ok(());
    }
    let [needed, free] = [bytes, free].map(size_text);
    let text = format!("{needed} more are needed, but {free} are free; make room or write elsewhere");
    Err(io::Error::new(io::ErrorKind::StorageFull, text))
}

/// Sorted runs, one behind another, in a file that is made with the first of them.
struct Spill {
    directory: PathBuf,
    runs: Mutex<Runs>,
}

#[derive(Default)]
struct Runs {
    file: Option<Arc<File>>,
    /// Runs that are being written or were written whole.
    ranges: Vec<Range<u64>>,
}

impl Spill {
    fn new(directory: &Path) -> Self {
        Self { directory: directory.into(), runs: Mutex::default() }
    }

    fn is_used(&self) -> bool {
        self.lock().file.is_some()
    }

    /// File and runs; none is being written any more.
    fn written(&self) -> io::Result<(Arc<File>, Vec<Range<u64>>)> {
        let runs = self.lock();
        let file = runs.file.clone().ok_or_else(|| io::Error::other("nothing was written"))?;
        Ok((file, runs.ranges.clone()))
    }

    /// Writes sorted records as a run of their own. Threads write at the same time, each to its own place.
    fn write_run(&self, records: &[SortKey]) -> io::Result<()> {
        if records.is_empty() {
            return Ok(());
        }
        let (file, mut offset) = self.reserve((records.len() * SortKey::BYTES) as u64)?;
        let mut bytes = Vec::with_capacity(WRITE_RECORDS * SortKey::BYTES);
        for part in records.chunks(WRITE_RECORDS) {
            bytes.clear();
            part.iter().for_each(|record| bytes.extend_from_slice(&record.to_bytes()));
            file.write_all_at(&bytes, offset)?;
            offset += bytes.len() as u64;
        }
        Ok(())
    }

    /// Writes all that is left of a merge as one run; `progress` takes the bytes this spill holds so far.
    fn append(&self, merge: &mut Merge, progress: &mut dyn FnMut(u64)) -> io::Result<()> {
        let (file, first) = self.reserve(merge.bytes_left())?;
        let mut offset = first;
        let mut bytes = Vec::with_capacity(WRITE_RECORDS * SortKey::BYTES);
        loop {
            let record = merge.next_record()?;
            if record == SortKey::END || bytes.len() == bytes.capacity() {
                file.write_all_at(&bytes, offset)?;
                offset += bytes.len() as u64;
                bytes.clear();
                progress(offset);
            }
            if record == SortKey::END {
                return Ok(());
            }
            bytes.extend_from_slice(&record.to_bytes());
        }
    }

    /// The file, and where a run of so many bytes may be written to it.
    fn reserve(&self, bytes: u64) -> io::Result<(Arc<File>, u64)> {
        check_free_space(&self.directory, bytes)?;
        let mut runs = self.lock();
        let file = match &runs.file {
            Some(file) => Arc::clone(file),
            None => Arc::new(tempfile::tempfile_in(&self.directory)?),
        };
        runs.file = Some(Arc::clone(&file));
        let offset = runs.ranges.last().map_or(0, |range| range.end);
        runs.ranges.push(offset..offset + bytes);
        Ok((file, offset))
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Runs> {
        // Whoever panicked here did so between two whole states.
        self.runs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
