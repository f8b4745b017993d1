//! Sorted runs, one after another, in a temporary file without a name. `sort` writes them, `merge` reads them.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::merge::Merge;
use crate::buildfile::primitive::{Key, Sortable};
use crate::text::size_text;

/// Keys turned into bytes at once when a run is written.
const WRITE_KEYS: usize = 2048;

/// The runs of a team. The file is created with the first run.
pub(super) struct Spill {
    directory: PathBuf,
    runs: Mutex<Runs>,
}

#[derive(Default)]
struct Runs {
    file: Option<Arc<File>>,
    /// Runs that are being written or are complete.
    ranges: Vec<Range<u64>>,
}

impl Spill {
    pub(super) fn new(directory: &Path) -> Self {
        Self { directory: directory.into(), runs: Mutex::default() }
    }

    /// An empty one in the same directory.
    pub(super) fn successor(&self) -> Self {
        Self::new(&self.directory)
    }

    /// Whether there is any run.
    pub(super) fn is_used(&self) -> bool {
        self.lock().file.is_some()
    }

    /// Length of all runs, bytes.
    pub(super) fn bytes(&self) -> u64 {
        self.lock().ranges.last().map_or(0, |range| range.end)
    }

    /// File and runs. Call it when no run is being written any more.
    pub(super) fn written(&self) -> io::Result<(Arc<File>, Vec<Range<u64>>)> {
        let runs = self.lock();
        let file = runs.file.clone().ok_or_else(|| io::Error::other("nothing was written"))?;
        Ok((file, runs.ranges.clone()))
    }

    /// Writes sorted keys as a run. Threads may write at the same time, each to its own place.
    pub(super) fn write_run<K: Key>(&self, keys: &[K]) -> io::Result<()> {
        if keys.is_empty() {
            return Ok(());
        }
        let (file, mut offset) = self.reserve((keys.len() * K::BYTES) as u64)?;
        let mut bytes = Vec::with_capacity(WRITE_KEYS * K::BYTES);
        for some in keys.chunks(WRITE_KEYS) {
            bytes.clear();
            some.iter().for_each(|key| key.append_to(&mut bytes));
            file.write_all_at(&bytes, offset)?;
            offset += bytes.len() as u64;
        }
        Ok(())
    }

    /// Writes all that is left of a merge as one run; `progress` takes the bytes that this spill holds so far.
    pub(super) fn append<P: Sortable>(&self, merge: &mut Merge<P>, progress: &mut dyn FnMut(u64)) -> io::Result<()> {
        let (file, first) = self.reserve(merge.bytes_left())?;
        let mut offset = first;
        let capacity = WRITE_KEYS * P::Key::BYTES;
        let mut bytes = Vec::with_capacity(capacity);
        loop {
            let key = merge.next_key()?;
            if key == P::Key::END || bytes.len() == capacity {
                file.write_all_at(&bytes, offset)?;
                offset += bytes.len() as u64;
                bytes.clear();
                progress(offset);
            }
            if key == P::Key::END {
                return Ok(());
            }
            key.append_to(&mut bytes);
        }
    }

    /// The file, and a free range of so many bytes in it.
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

    fn lock(&self) -> MutexGuard<'_, Runs> {
        // A panic while the lock is held leaves the list consistent.
        self.runs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Checks before writing that `bytes` fit the file system of `directory`.
///
/// # Errors
/// States how much is needed and how much is free.
pub(in crate::buildfile) fn check_free_space(directory: &Path, bytes: u64) -> io::Result<()> {
    let free = crate::disk::free_bytes(directory)?;
    if free >= bytes {
        return Ok(());
    }
    let [needed, free] = [bytes, free].map(size_text);
    let text = format!("{needed} more are needed, but {free} are free; make room or write elsewhere");
    Err(io::Error::new(io::ErrorKind::StorageFull, text))
}
