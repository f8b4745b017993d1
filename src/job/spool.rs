//! The spool: one directory per job, from its acceptance until it is forgotten.
//!
//! ```text
//! SPOOL/lock                      held by the daemon that owns the spool
//! SPOOL/incoming/…                parts being received; deleted at the next opening
//! SPOOL/raised                    height from which the plate was raised, until it is confirmed to be empty, micrometres
//! SPOOL/jobs/00000001/part.layerd  never changed; jobs that print one part again share the file (hard links)
//!                    /recipe.toml  as it was when the job was accepted
//!                    /machine.toml
//!                    /journal
//!                    /resin        about how much the part takes; missing until that is estimated
//! SPOOL/jobs/00000002-0123456789abcdef-clear  empty: a job that was removed, and its key
//! ```
//!
//! A job appears whole or not at all: its directory is made under a hidden name, flushed, renamed, and its parent flushed.
//! Of jobs that are over, the newest [`MAX_RECORDS`] are kept for `layerctl jobs`, and the parts of the newest
//! [`MAX_PARTS`]. [`Spool::tidy`] deletes the rest; [`Spool::remove`] deletes the job that an operator names.
//!
//! The directory of a removed job is emptied and renamed; a rename needs no space on a full disk. Its name keeps what must still
//! be known: the job's number, which is not used again; its key, which a device may report; and whether its part was left in
//! the vat (`-left` or `-clear` after the key). Tested by `tests/job_spool.rs` and `tests/orders.rs`.

mod directory;
mod raised;

use std::fs::TryLockError;
use std::path::{Path, PathBuf};

pub use self::directory::{Forgotten, JobDirectory, PlateAfter};
use self::directory::{JOURNAL, MACHINE, PART, RECIPE};
use super::{Journal, JournalError, Record};
use crate::device::Passes;
use crate::disk::{self, File, How, TempPath, sync_parent};
use crate::text::size_text;

/// Finished jobs whose records are kept: some months of a busy machine, a few kilobytes to megabytes each.
pub const MAX_RECORDS: usize = 100;
/// Finished jobs whose part files are kept, each up to gigabytes.
pub const MAX_PARTS: usize = 10;
/// Removed jobs that are remembered by key. A device reports the last exposure that it cut short, which may be many jobs old.
pub const MAX_FORGOTTEN: usize = 1000;

/// A spool that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SpoolError {
    /// A file operation failed.
    #[error("cannot {what} {}: {source}", path.display())]
    Io {
        /// What was tried.
        what: &'static str,
        /// The file or directory.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Another daemon owns the spool.
    #[error(
        "the spool {} is in use by another layerd, or by one that is still ending (up to 110 s); stop it, wait for its end, or give \
         this one its own `spool`", .0.display()
    )]
    InUse(PathBuf),
    /// Not enough room.
    #[error(
        "the disk of {} has {} free; {} are needed, of which {} stay free for journals: `layerctl remove JOB` deletes jobs that are \
         over; or delete other files there, or move the spool",
        path.display(), size_text(*free_bytes), size_text(*need_bytes), size_text(disk::RESERVE_BYTES)
    )]
    NoSpace {
        /// The spool.
        path: PathBuf,
        /// Free bytes.
        free_bytes: u64,
        /// Needed bytes, the reserve included.
        need_bytes: u64,
    },
    /// All job numbers are used up.
    #[error("the spool {} has used all job numbers; empty it", .0.display())]
    NumbersUsedUp(PathBuf),
    /// The job's journal could not be created.
    #[error(transparent)]
    Journal(#[from] JournalError),
}

/// The spool directory, held for this process alone.
#[derive(Debug)]
pub struct Spool {
    root: PathBuf,
    _lock: File,
}

/// What a new job needs besides its part.
#[derive(Clone, Debug)]
pub struct NewJob<'a> {
    /// The part, received whole, on the spool's file system (see [`Spool::incoming`]); moved into the job.
    pub part: &'a Path,
    /// Text of the recipe.
    pub recipe: &'a str,
    /// Text of the machine file.
    pub machine: &'a str,
    /// The journal's first record, [`Record::Accepted`].
    pub accepted: Record,
    /// The exposures of its layers.
    pub passes: &'a Passes,
    /// Wall clock, milliseconds since 1970.
    pub at_unix_ms: u64,
}

impl Spool {
    /// Opens a spool, or creates it, and deletes what an earlier process left unfinished.
    ///
    /// # Errors
    /// [`SpoolError`]: no access, or in use by another process.
    pub fn open(root: &Path) -> Result<Self, SpoolError> {
        for directory in [root.to_path_buf(), root.join("jobs"), root.join("incoming")] {
            disk::create_directories(&directory).map_err(io("create", &directory))?;
        }
        // An earlier start may have been killed before it flushed these names.
        disk::sync_directory(root).map_err(io("flush", root))?;
        let lock_path = root.join("lock");
        let lock = File::open(&lock_path, How::Create).map_err(io("open", &lock_path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(SpoolError::InUse(root.into())),
            Err(TryLockError::Error(source)) => return Err(io("lock", &lock_path)(source)),
        }
        let spool = Self { root: root.into(), _lock: lock };
        spool.delete_leftovers()?;
        Ok(spool)
    }

    /// Where parts are received: on the same file system as the jobs, emptied at every opening.
    pub fn incoming(&self) -> PathBuf {
        Self::incoming_of(&self.root)
    }

    /// The same of the spool at `root`, which another part of the process holds.
    pub fn incoming_of(root: &Path) -> PathBuf {
        root.join("incoming")
    }

    /// The part of a job once more, as a file of its own name among those received: for another job. Both names are one file, which
    /// stays until the last of its jobs is removed.
    ///
    /// # Errors
    /// [`SpoolError::Io`]: the part is no longer there, or the file system has no hard links.
    pub fn part_again(&self, job: &JobDirectory) -> Result<TempPath, SpoolError> {
        let part = job.part();
        let named = TempPath::link_in(&self.incoming(), "again-", &part);
        named.map_err(|error| io("link", &part)(linking(error)))
    }

    /// Checks that `bytes` more fit.
    ///
    /// # Errors
    /// [`SpoolError::NoSpace`] says how much is there and how much is needed.
    pub fn check_space(&self, bytes: u64) -> Result<(), SpoolError> {
        let free_bytes = disk::free_bytes(&self.root).map_err(io("ask the free space of", &self.root))?;
        let need_bytes = bytes.saturating_add(disk::RESERVE_BYTES);
        if free_bytes >= need_bytes {
            return Ok(());
        }
        Err(SpoolError::NoSpace { path: self.root.clone(), free_bytes, need_bytes })
    }

    /// Makes a job from a received part: whole or not at all, flushed.
    ///
    /// # Errors
    /// [`SpoolError`]; then the part stays where it was, and nothing else is left behind.
    pub fn create(&self, job: NewJob<'_>) -> Result<(JobDirectory, Journal), SpoolError> {
        let jobs = self.root.join("jobs");
        let known = self.jobs()?.last().map(|job| job.id);
        let last = known.max(self.forgotten()?.last().map(|job| job.id)).unwrap_or(0);
        let id = last.checked_add(1).ok_or_else(|| SpoolError::NumbersUsedUp(self.root.clone()))?;
        let directory = JobDirectory::of(&self.root, id);
        let hidden = jobs.join(format!(".{}", JobDirectory::name(id)));
        let part = job.part.to_path_buf();
        let made = self.fill(&hidden, job).and_then(|journal| {
            disk::rename(&hidden, directory.path()).map_err(io("rename", &hidden))?;
            sync_parent(directory.path()).map_err(io("flush", &jobs))?;
            Ok(journal.moved_to(directory.journal()))
        });
        let journal = made.inspect_err(|_| {
            // Best effort: the next opening deletes what is left under a hidden name.
            let _ = disk::rename(directory.path(), &hidden);
            let _ = disk::rename(&hidden.join(PART), &part);
            let _ = disk::remove_tree(&hidden);
            let _ = disk::sync_directory(&jobs);
        })?;
        Ok((directory, journal))
    }

    fn fill(&self, hidden: &Path, job: NewJob<'_>) -> Result<Journal, SpoolError> {
        disk::create_directory(hidden).map_err(io("create", hidden))?;
        for (name, text) in [(RECIPE, job.recipe), (MACHINE, job.machine)] {
            let path = hidden.join(name);
            let write = || {
                let file = File::open(&path, How::CreateNew)?;
                file.write_all_at(text.as_bytes(), 0)?;
                file.sync_all()
            };
            write().map_err(io("write", &path))?;
        }
        let mut journal = Journal::create(&hidden.join(JOURNAL), job.accepted, job.at_unix_ms)?;
        if job.passes.has_several() {
            journal.append(Record::Passes(job.passes.clone()), job.at_unix_ms)?;
        }
        let flush_part = File::open(job.part, How::Read).and_then(|file| file.sync_all());
        flush_part.map_err(io("flush", job.part))?;
        disk::rename(job.part, &hidden.join(PART)).map_err(io("move", job.part))?;
        sync_parent(&hidden.join(PART)).map_err(io("flush", hidden))?;
        Ok(journal)
    }

    /// All jobs, in order of acceptance.
    ///
    /// # Errors
    /// [`SpoolError::Io`] if the directory cannot be read.
    pub fn jobs(&self) -> Result<Vec<JobDirectory>, SpoolError> {
        let mut found: Vec<_> = self.entries()?.into_iter().filter_map(JobDirectory::from_path).collect();
        found.sort_by_key(|job| job.id);
        Ok(found)
    }

    /// What is still known of removed jobs, in order of acceptance.
    ///
    /// # Errors
    /// [`SpoolError::Io`] if the directory cannot be read.
    pub fn forgotten(&self) -> Result<Vec<Forgotten>, SpoolError> {
        let mut found: Vec<_> = self.entries()?.iter().filter_map(|path| Forgotten::of(path)).collect();
        found.sort_by_key(|job| job.id);
        Ok(found)
    }

    fn entries(&self) -> Result<Vec<PathBuf>, SpoolError> {
        listed(&self.root.join("jobs"))
    }

    /// Deletes the parts and records of jobs that are over, beyond [`MAX_PARTS`] and [`MAX_RECORDS`]. `over` lists those jobs.
    /// Returns the numbers of the jobs whose records were deleted.
    ///
    /// # Errors
    /// [`SpoolError::Io`] names what could not be deleted.
    pub fn tidy(&self, over: &[Forgotten]) -> Result<Vec<u32>, SpoolError> {
        let mut forgotten = Vec::new();
        let jobs = self.jobs()?;
        let of = |job: &JobDirectory| over.iter().find(|over| over.id == job.id);
        for (age, (job, over)) in jobs.iter().rev().filter_map(|job| Some((job, of(job)?))).enumerate() {
            if age >= MAX_RECORDS {
                self.remove(*over)?;
                forgotten.push(job.id);
            } else if age >= MAX_PARTS && disk::exists(&job.part()) {
                disk::remove_file(&job.part()).map_err(io("delete", &job.part()))?;
            }
        }
        Ok(forgotten)
    }

    /// Deletes part and records of a job that is over. Returns the number of bytes freed.
    ///
    /// # Errors
    /// [`SpoolError::Io`] names what could not be deleted; what is left then is deleted at the next opening.
    pub fn remove(&self, job: Forgotten) -> Result<u64, SpoolError> {
        let jobs = self.root.join("jobs");
        let (from, to) = (jobs.join(JobDirectory::name(job.id)), jobs.join(job.name()));
        // Atomic. If an earlier try stopped after the rename, this one continues from there.
        if !disk::is_directory(&to) {
            disk::rename(&from, &to).map_err(io("remove", &from))?;
        }
        // Before it is emptied: a power cut must not leave a job without its journal.
        sync_parent(&to).map_err(io("flush", &jobs))?;
        let bytes = empty(&to)?;
        let mut forgotten = self.forgotten()?;
        forgotten.truncate(forgotten.len().saturating_sub(MAX_FORGOTTEN));
        for old in forgotten {
            let path = jobs.join(old.name());
            disk::remove_directory(&path).map_err(io("delete", &path))?;
        }
        Ok(bytes)
    }

    fn delete_leftovers(&self) -> Result<(), SpoolError> {
        for path in listed(&self.incoming())? {
            delete(&path)?;
        }
        self.clear_raised()?;
        for path in self.entries()? {
            if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.')) {
                delete(&path)?;
            } else if Forgotten::of(&path).is_some() {
                empty(&path)?;
            } else if let Some(job) = JobDirectory::from_path(path) {
                let resin = job.resin();
                disk::remove_unfinished(&resin).map_err(io("delete", &resin))?;
            }
        }
        Ok(())
    }
}

fn listed(directory: &Path) -> Result<Vec<PathBuf>, SpoolError> {
    disk::list(directory).map_err(io("list", directory))
}

fn delete(path: &Path) -> Result<(), SpoolError> {
    disk::remove_tree(path).map_err(io("delete", path))
}

/// Deletes the contents of a directory and returns the number of bytes freed. A job's directory is flat.
fn empty(directory: &Path) -> Result<u64, SpoolError> {
    let mut bytes = 0;
    for path in listed(directory)? {
        // A part that another job prints, too, stays on the disk.
        bytes += disk::freed_bytes(&path);
        delete(&path)?;
    }
    Ok(bytes)
}

/// Says what it means if a file system refuses a hard link.
fn linking(error: std::io::Error) -> std::io::Error {
    use std::io::ErrorKind::{PermissionDenied, Unsupported};
    if !matches!(error.kind(), PermissionDenied | Unsupported) {
        return error;
    }
    let text = format!("{error}. If its file system has no hard links (FAT has none), start the build file instead");
    std::io::Error::new(error.kind(), text)
}

fn io<'a>(what: &'static str, path: &'a Path) -> impl Fn(std::io::Error) -> SpoolError + use<'a> {
    move |source| SpoolError::Io { what, path: path.into(), source }
}
