//! The journal of one job: an append-only file in which every record is checksummed and on disk before the next act.
//!
//! ```text
//! "layerjnl" version:u32     then for each record     length:u32 crc32:u32 payload
//! ```
//!
//! ```
//! # let directory = tempfile::tempdir()?;
//! # let path = directory.path().join("journal");
//! use layerd::job::{Journal, Record};
//!
//! let accepted = Record::Accepted { key: 7, layer_count: 100, name: "cube".into() };
//! let mut journal = Journal::create(&path, accepted, 1_767_225_600_000)?;
//! journal.append(Record::Started { exposure: 0 }, 1_767_225_601_000)?;
//! drop(journal);
//! let (_, history) = Journal::open(&path)?;
//! assert_eq!((history.next_exposure, history.passes.layer_count()), (0, 100));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Little endian; the CRC-32 (IEEE) covers length and payload; the payload is an [`Entry`] in [`crate::codec`]'s form.
//! When the journal is created, space for the last records is reserved beyond the file's end (fallocate(2), size kept). If the
//! disk fills up, the print stops before its next layer, but confirmations, orders and the end can still be written. The record
//! that ends the job for good releases the space.
//!
//! A crash can leave one half-written record at the end. It was never reported as written, so it is cut off. A last record of full
//! length with a wrong checksum may be such a write, too, if its blocks reached the disk out of order. It is dropped as well, and
//! [`History::dropped`] says so. Damage anywhere else is an error: with a record missing, a layer could be exposed twice.

mod entries;

use std::path::{Path, PathBuf};

use bincode::{Decode, Encode};
use rustix::io::Errno;

pub use self::entries::Entries;
use super::{Contradiction, History, JobState, Record};
use crate::codec;
use crate::disk::{self, File, How};

/// A record and when it was written.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct Entry {
    /// Wall clock, milliseconds since 1970. Only for people: no decision depends on it.
    pub at_unix_ms: u64,
    /// What happened.
    pub record: Record,
}

/// A journal that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// The file could not be read or written.
    #[error("cannot {what} the journal {}: {source}{}", path.display(), remedy(source))]
    Io {
        /// What was tried.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The open file is no longer at its path.
    #[error(
        "the journal {} is no longer there: its directory was deleted, renamed or unmounted while the job ran. Put it back, \
         or end the job with `layerctl abort`", path.display()
    )]
    Vanished {
        /// Where it stood.
        path: PathBuf,
    },
    /// The open file has another length than what was written.
    #[error(
        "the journal {} has {found_bytes} bytes, but {written_bytes} were written: something else changed the file while the job \
         ran. Restore it, or end the job with `layerctl abort`", path.display()
    )]
    Altered {
        /// The file.
        path: PathBuf,
        /// Its length, bytes.
        found_bytes: u64,
        /// What was written and flushed, bytes.
        written_bytes: u64,
    },
    /// Not a journal of this version, or damaged.
    #[error("the journal {} is damaged: {what}; the job cannot be resumed, start the part again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where, and what was found.
        what: String,
    },
    /// Its records contradict each other.
    #[error("the journal {} is not valid: {source}; the job cannot be resumed, start the part again", path.display())]
    Contradiction {
        /// The file.
        path: PathBuf,
        /// Which record, and how.
        source: Contradiction,
    },
}

impl JournalError {
    /// Whether the journal may become readable once the disk or the permissions are repaired.
    pub fn may_be_mended(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() != std::io::ErrorKind::NotFound)
    }
}

/// What to do about a full disk.
fn remedy(source: &std::io::Error) -> &'static str {
    use std::io::ErrorKind::{QuotaExceeded, StorageFull};
    match source.kind() {
        StorageFull | QuotaExceeded => "; make room on that disk (`layerctl remove JOB` deletes jobs that are over)",
        _ => "",
    }
}

const MAGIC: [u8; 12] = *b"layerjnl\x01\0\0\0";
const FRAME_BYTES: usize = 8;
/// The longest record is an end with its reason, which the engine keeps below 4 KiB.
const MAX_RECORD_BYTES: usize = 16 << 10;
/// Space for 1.5 million layers at two records of 40 bytes each.
const MAX_JOURNAL_BYTES: u64 = 128 << 20;
/// Space that records which begin something leave free. A confirmation, orders and an end need less than two of the longest
/// records.
const RESERVE_BYTES: u64 = 2 * MAX_RECORD_BYTES as u64;
/// Space that only a final end may use: a job interrupted repeatedly on a full disk must still be ended.
const FINAL_BYTES: u64 = MAX_RECORD_BYTES as u64;
/// Space reserved in one step: some eighty layers, so that most records need no system call.
const STEP_BYTES: u64 = 4 << 10;

/// An open journal; the only writer of its file.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    /// Bytes known to be on disk.
    length_bytes: u64,
    /// Space is reserved up to here.
    reserved_bytes: u64,
    /// The file system cannot reserve space.
    unreserved: bool,
    /// A flush failed, so it is unknown what is on disk. Nothing more is appended.
    broken: bool,
}

impl Journal {
    /// Creates a journal that must not exist yet and flushes it and its directory.
    ///
    /// # Errors
    /// [`JournalError::Io`]; nothing is left behind then.
    pub fn create(path: &Path, first: Record, at_unix_ms: u64) -> Result<Self, JournalError> {
        let io = |source| JournalError::Io { what: "create", path: path.into(), source };
        let file = File::open(path, How::CreateNew).map_err(io)?;
        let mut journal = Self::new(path, file, 0);
        let written = journal.write(&MAGIC).and_then(|()| journal.append(first, at_unix_ms));
        let synced = written.and_then(|()| disk::sync_parent(path).map_err(io));
        if let Err(error) = synced {
            // Best effort: the error that matters is the first one.
            let _ = disk::remove_file(path);
            return Err(error);
        }
        Ok(journal)
    }

    /// Opens a journal to continue it, and returns its history. A half-written or damaged record at its end is cut off.
    ///
    /// # Errors
    /// [`JournalError`] if the file cannot be read, is damaged, or contradicts itself.
    pub fn open(path: &Path) -> Result<(Self, History), JournalError> {
        let io = |source| JournalError::Io { what: "open", path: path.into(), source };
        let mut read = Entries::of(path, File::open(path, How::ReadWrite).map_err(io)?);
        let entries = read.by_ref().collect::<Result<Vec<_>, _>>()?;
        let (history, length_bytes) = (replay(path, &entries, &read)?, read.length_bytes());
        let file = read.into_file();
        if file.metadata().map_err(io)?.length_bytes > length_bytes {
            file.set_len(length_bytes).and_then(|()| file.sync_all()).map_err(io)?;
        }
        let mut journal = Self::new(path, file, length_bytes);
        if !history.state.is_final() {
            // If the disk is full, the next record reports it.
            let _ = journal.reserve(RESERVE_BYTES);
        }
        Ok((journal, history))
    }

    fn new(path: &Path, file: File, length_bytes: u64) -> Self {
        Self { path: path.into(), file, length_bytes, reserved_bytes: length_bytes, unreserved: false, broken: false }
    }

    /// The same journal after its directory was renamed.
    pub(super) fn moved_to(self, path: PathBuf) -> Self {
        Self { path, ..self }
    }

    /// Whether space is reserved. Without it, a full disk can keep the end of a job from being written.
    pub fn is_reserved(&self) -> bool {
        !self.unreserved
    }

    /// Appends a record; on return it is on disk.
    ///
    /// # Errors
    /// [`JournalError::Io`]: the disk is full or fails. Earlier records stay valid. If the record was refused because it would
    /// have used the reserved space, the last records can still be appended; after any other error nothing can be.
    /// [`JournalError::Vanished`]: the file is no longer at its path. [`JournalError::Altered`]: its length was changed.
    pub fn append(&mut self, record: Record, at_unix_ms: u64) -> Result<(), JournalError> {
        let is_final = matches!(record, Record::Ended { state, .. } if state.is_final());
        let leaves_bytes = match &record {
            record if !record.is_last() => RESERVE_BYTES,
            Record::Ended { state: JobState::Interrupted, .. } => FINAL_BYTES,
            _ => 0,
        };
        let payload = codec::encode(&Entry { at_unix_ms, record })
            .map_err(|error| self.io_error(std::io::Error::other(error)))?;
        let length = u32::try_from(payload.len()).unwrap_or(u32::MAX);
        if payload.len() > MAX_RECORD_BYTES {
            return Err(self.io_error(std::io::Error::other(format!("a record of {length} bytes is too long"))));
        }
        let mut frame = Vec::with_capacity(FRAME_BYTES + payload.len());
        frame.extend(length.to_le_bytes());
        frame.extend(checksum(length, &payload).to_le_bytes());
        frame.extend(payload);
        self.check_length()?;
        // The last records are tried in any case: the space is reserved for them.
        self.reserve(frame.len() as u64 + leaves_bytes)
            .or_else(|error| if leaves_bytes == 0 { Ok(()) } else { Err(error) })?;
        self.write(&frame)?;
        self.check_place()?;
        if is_final {
            // Best effort: space that is not released does no harm.
            let _ = self.file.set_len(self.length_bytes);
        }
        Ok(())
    }

    /// Reserves this much space beyond what is written.
    fn reserve(&mut self, bytes: u64) -> Result<(), JournalError> {
        if self.unreserved || self.length_bytes + bytes <= self.reserved_bytes {
            return Ok(());
        }
        let set_aside = |bytes| self.file.reserve(self.length_bytes, bytes).map(|()| bytes);
        match set_aside(bytes + STEP_BYTES).or_else(|_| set_aside(bytes)) {
            Ok(bytes) => self.reserved_bytes = self.length_bytes + bytes,
            Err(error) => match Errno::from_io_error(&error) {
                Some(Errno::OPNOTSUPP | Errno::NOSYS | Errno::INVAL | Errno::NODEV) => self.unreserved = true,
                _ => return Err(self.io_error(error)),
            },
        }
        Ok(())
    }

    /// Checks that nothing else cut or extended the file since the last record: a record behind a gap cannot be read.
    fn check_length(&mut self) -> Result<(), JournalError> {
        let found_bytes = match self.file.metadata() {
            Ok(metadata) => metadata.length_bytes,
            Err(error) => return Err(self.broken_by(error)),
        };
        if found_bytes == self.length_bytes {
            return Ok(());
        }
        self.broken = true;
        Err(JournalError::Altered { path: self.path.clone(), found_bytes, written_bytes: self.length_bytes })
    }

    /// Checks that the file is still the one at its path. A deleted file takes records without an error, but they are lost.
    fn check_place(&mut self) -> Result<(), JournalError> {
        let place = disk::metadata(&self.path).and_then(|there| self.file.metadata().map(|open| (there, open)));
        match place {
            Ok((there, open)) if there.identity == open.identity => Ok(()),
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(self.broken_by(error)),
            _ => {
                self.broken = true;
                Err(JournalError::Vanished { path: self.path.clone() })
            }
        }
    }

    fn broken_by(&mut self, source: std::io::Error) -> JournalError {
        self.broken = true;
        self.io_error(source)
    }

    /// Writes bytes that belong together and flushes them.
    fn write(&mut self, bytes: &[u8]) -> Result<(), JournalError> {
        if self.broken {
            return Err(self.io_error(std::io::Error::other("an earlier write failed")));
        }
        if let Err(source) = self.file.write_all_at(bytes, self.length_bytes).and_then(|()| self.file.sync_data()) {
            // Best effort: the next opening cuts a torn record off as well.
            let _ = self.file.set_len(self.length_bytes).and_then(|()| self.file.sync_data());
            return Err(self.broken_by(source));
        }
        self.length_bytes += bytes.len() as u64;
        Ok(())
    }

    fn io_error(&self, source: std::io::Error) -> JournalError {
        JournalError::Io { what: "write", path: self.path.clone(), source }
    }
}

/// Reads a journal without touching it.
///
/// # Errors
/// As [`Journal::open`].
pub fn read_journal(path: &Path) -> Result<(Vec<Entry>, History), JournalError> {
    let mut read = Entries::open(path)?;
    let entries = read.by_ref().collect::<Result<Vec<_>, _>>()?;
    let history = replay(path, &entries, &read)?;
    Ok((entries, history))
}

fn replay(path: &Path, entries: &[Entry], read: &Entries) -> Result<History, JournalError> {
    let mut history = History::replay(entries.iter().map(|entry| &entry.record))
        .map_err(|source| JournalError::Contradiction { path: path.into(), source })?;
    history.dropped = read.dropped().map(str::to_owned);
    Ok(history)
}

fn checksum(length: u32, payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&length.to_le_bytes());
    hasher.update(payload);
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use std::fs::OpenOptions;
    use std::io::Write;

    use super::*;

    /// `/dev/full` answers every write with "no space left on device".
    #[test]
    fn a_full_disk_is_told_once_and_ends_the_journal() {
        let Ok(file) = OpenOptions::new().write(true).open("/dev/full") else {
            return writeln!(std::io::stderr(), "skipped: no /dev/full").expect("stderr");
        };
        let mut journal = Journal::new(Path::new("/dev/full"), file.into(), 0);
        let full = journal.append(Record::Paused, 0).expect_err("no space").to_string();
        assert!(full.contains("/dev/full") && full.contains("No space left"), "{full}");
        let after = journal.append(Record::Paused, 0).expect_err("broken").to_string();
        assert!(after.contains("earlier write failed"), "{after}");
    }
}
