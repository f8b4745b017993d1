//! Reads a journal record by record, in little memory however long it is. Tested by `tests/job_journal.rs`.

use std::path::{Path, PathBuf};

use super::{Entry, FRAME_BYTES, JournalError, MAGIC, MAX_JOURNAL_BYTES, MAX_RECORD_BYTES, checksum};
use crate::codec;
use crate::disk::{File, How};

/// Bytes that must be at hand to judge a record: with more than the longest record at hand, damage is no unfinished write.
const WINDOW_BYTES: usize = FRAME_BYTES + MAX_RECORD_BYTES + 1;
/// Bytes read at once: some thousand records.
const PIECE_BYTES: usize = 64 << 10;

/// The entries of a journal, in order. After an error there are no more.
#[derive(Debug)]
pub struct Entries {
    path: PathBuf,
    file: File,
    /// Bytes read and not yet taken.
    bytes: Vec<u8>,
    /// The part of `bytes` that is taken.
    taken: usize,
    /// Place of the next record in the file.
    at: u64,
    /// Number of the next record.
    index: usize,
    has_magic: bool,
    is_read: bool,
    is_over: bool,
    dropped: Option<String>,
}

impl Entries {
    /// Opens a journal to read it. Another process or thread may append to it meanwhile: a record that is half written is not there
    /// yet.
    ///
    /// # Errors
    /// [`JournalError::Io`].
    pub fn open(path: &Path) -> Result<Self, JournalError> {
        File::open(path, How::Read).map(|file| Self::of(path, file)).map_err(|source| io("open", path, source))
    }

    /// The entries of an open file.
    pub(super) fn of(path: &Path, file: File) -> Self {
        Self {
            path: path.into(),
            file,
            bytes: Vec::with_capacity(PIECE_BYTES + WINDOW_BYTES),
            taken: 0,
            at: 0,
            index: 0,
            has_magic: false,
            is_read: false,
            is_over: false,
            dropped: None,
        }
    }

    /// The open file.
    pub(super) fn into_file(self) -> File {
        self.file
    }

    /// Bytes of the whole records so far, the file's beginning included.
    pub(super) fn length_bytes(&self) -> u64 {
        self.at
    }

    /// What was dropped at the end of the journal because it was damaged, once all entries are read; `None` if nothing was, or
    /// only a record whose writing was cut short.
    pub fn dropped(&self) -> Option<&str> {
        self.dropped.as_deref()
    }

    fn read(&mut self) -> Result<Option<Entry>, JournalError> {
        self.fill()?;
        if !self.has_magic {
            if !self.rest().starts_with(&MAGIC) {
                return Err(self.damaged("it does not begin like a journal of version 1".into()));
            }
            self.take(MAGIC.len());
            self.has_magic = true;
            self.fill()?;
        }
        if self.rest().is_empty() {
            return Ok(None);
        }
        let Some(payload) = frame(self.rest()) else {
            let place = format!("record {} at byte {} is not what was written", self.index, self.at);
            if !is_torn_tail(self.rest()) {
                return Err(self.damaged(place));
            }
            if !is_cut_short(self.rest()) {
                let path = self.path.display();
                self.dropped =
                    Some(format!("the last record of the journal {path} is damaged and was dropped: {place}"));
            }
            return Ok(None);
        };
        let length = FRAME_BYTES + payload.len();
        let entry = codec::decode::<Entry, MAX_RECORD_BYTES>(payload)
            .map_err(|error| self.damaged(format!("record {} at byte {}: {error}", self.index, self.at)))?;
        self.take(length);
        self.index += 1;
        Ok(Some(entry))
    }

    /// Reads on until a whole window or the rest of the file is at hand.
    fn fill(&mut self) -> Result<(), JournalError> {
        if self.is_read || self.rest().len() >= WINDOW_BYTES {
            return Ok(());
        }
        self.bytes.drain(..self.taken);
        self.taken = 0;
        // A file may come in pieces of any length.
        while !self.is_read && self.bytes.len() < WINDOW_BYTES {
            let from = self.at + self.bytes.len() as u64;
            let read = self.file.append_to(&mut self.bytes, from, PIECE_BYTES);
            let count = read.map_err(|source| io("read", &self.path, source))?;
            self.is_read = count < PIECE_BYTES;
            if self.at + self.bytes.len() as u64 > MAX_JOURNAL_BYTES {
                return Err(self.damaged(format!("it has more than {MAX_JOURNAL_BYTES} bytes")));
            }
        }
        Ok(())
    }

    fn rest(&self) -> &[u8] {
        &self.bytes[self.taken..]
    }

    fn take(&mut self, bytes: usize) {
        self.taken += bytes;
        self.at += bytes as u64;
    }

    fn damaged(&self, what: String) -> JournalError {
        JournalError::Damaged { path: self.path.clone(), what }
    }
}

impl Iterator for Entries {
    type Item = Result<Entry, JournalError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_over {
            return None;
        }
        let next = self.read().transpose();
        self.is_over = !matches!(next, Some(Ok(_)));
        next
    }
}

fn io(what: &'static str, path: &Path, source: std::io::Error) -> JournalError {
    JournalError::Io { what, path: path.into(), source }
}

/// The payload of the record at the start of `bytes`; `None` if it is incomplete or damaged.
fn frame(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = bytes.split_first_chunk::<4>()?;
    let (crc, rest) = rest.split_first_chunk::<4>()?;
    let length = u32::from_le_bytes(*length);
    if length == 0 || length as usize > MAX_RECORD_BYTES {
        return None;
    }
    let payload = rest.get(..length as usize)?;
    (checksum(length, payload) == u32::from_le_bytes(*crc)).then_some(payload)
}

/// Whether the file ends before the record at the start of `tail` does. A write that was torn out of order leaves a record that is
/// whole in length; that looks like any other damage.
fn is_cut_short(tail: &[u8]) -> bool {
    let Some(length) = tail.first_chunk() else { return true };
    let length = u32::from_le_bytes(*length) as usize;
    (1..=MAX_RECORD_BYTES).contains(&length) && tail.len() < FRAME_BYTES + length
}

/// Whether `tail` can be a single unfinished write: it is short, and no valid record follows in it.
fn is_torn_tail(tail: &[u8]) -> bool {
    tail.len() < WINDOW_BYTES && (1..tail.len()).all(|skip| frame(&tail[skip..]).is_none())
}
