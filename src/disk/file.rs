//! An open file. `job/journal.rs` appends to one, `buildfile/store/reader.rs` reads one.

use std::io::{self, ErrorKind};
use std::path::Path;

use super::{metadata, on_disk};
use crate::system::{DiskFile, FileKind, How, Metadata};

/// An open file. Several threads may use it at once: every read and write states its place.
#[derive(Debug)]
pub(crate) struct File(Box<dyn DiskFile>);

impl From<std::fs::File> for File {
    fn from(file: std::fs::File) -> Self {
        Self(Box::new(file))
    }
}

impl File {
    /// Opens a regular file, or a link to one. Never waits for the other end of a pipe, and does not open devices.
    ///
    /// # Errors
    /// As open(2), and if there is something else at `path`.
    pub(crate) fn open(path: &Path, how: How) -> io::Result<Self> {
        let regular = |found: Metadata| match found.kind {
            FileKind::File => Ok(()),
            _ => Err(io::Error::other("it is not a regular file")),
        };
        // Before it is opened: opening a device can have effects. A file that `how` creates is not there yet.
        match metadata(path) {
            Ok(found) => regular(found)?,
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        let file = Self(on_disk(|disk| disk.open(path, how))?);
        // A file that was made now is one, and would be left over if this failed.
        if !matches!(how, How::CreateNew | How::CreatePrivate) {
            regular(file.metadata()?)?;
        }
        Ok(file)
    }

    /// Reads some bytes from `offset` on; 0 at the end.
    ///
    /// # Errors
    /// As pread(2).
    pub(crate) fn read_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<usize> {
        loop {
            match self.0.read_at(bytes, offset) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                read => return read,
            }
        }
    }

    /// Fills `bytes` from `offset` on.
    ///
    /// # Errors
    /// As pread(2), and if the file ends before.
    pub(crate) fn read_exact_at(&self, mut bytes: &mut [u8], mut offset: u64) -> io::Result<()> {
        while !bytes.is_empty() {
            match self.read_at(bytes, offset)? {
                0 => return Err(io::Error::new(ErrorKind::UnexpectedEof, "the file ends too early")),
                count => {
                    bytes = &mut bytes[count..];
                    offset += count as u64;
                }
            }
        }
        Ok(())
    }

    /// Reads on from `offset` up to `limit_bytes`, or to the end. A file that grows meanwhile is read up to the limit.
    ///
    /// # Errors
    /// As pread(2).
    pub(crate) fn append_to(&self, bytes: &mut Vec<u8>, offset: u64, limit_bytes: usize) -> io::Result<usize> {
        let before = bytes.len();
        // No more than there is to read is filled with zeros before; the byte more finds the end.
        let left_bytes = self.metadata()?.length_bytes.saturating_sub(offset).saturating_add(1);
        let limit_bytes = limit_bytes.min(usize::try_from(left_bytes).unwrap_or(usize::MAX));
        bytes.resize(before + limit_bytes, 0);
        let mut count = 0;
        let read = loop {
            match self.read_at(&mut bytes[before + count..], offset + count as u64) {
                // At the end, or at the limit.
                Ok(0) => break Ok(count),
                Ok(more) => count += more,
                Err(error) => break Err(error),
            }
        };
        bytes.truncate(before + count);
        read
    }

    /// Writes all of `bytes` from `offset` on.
    ///
    /// # Errors
    /// As pwrite(2).
    pub(crate) fn write_all_at(&self, mut bytes: &[u8], mut offset: u64) -> io::Result<()> {
        while !bytes.is_empty() {
            match self.0.write_at(bytes, offset) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => {
                    bytes = &bytes[count..];
                    offset += count as u64;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Cuts or extends the file, and releases space beyond its end.
    ///
    /// # Errors
    /// As ftruncate(2).
    pub(crate) fn set_len(&self, bytes: u64) -> io::Result<()> {
        self.0.set_len(bytes)
    }

    /// Flushes content and length.
    ///
    /// # Errors
    /// As fdatasync(2).
    pub(crate) fn sync_data(&self) -> io::Result<()> {
        self.0.sync(false)
    }

    /// Flushes content and metadata.
    ///
    /// # Errors
    /// As fsync(2).
    pub(crate) fn sync_all(&self) -> io::Result<()> {
        self.0.sync(true)
    }

    /// Sets space aside for the bytes from `offset` on, also beyond the file's end.
    ///
    /// # Errors
    /// As fallocate(2).
    pub(crate) fn reserve(&self, offset: u64, bytes: u64) -> io::Result<()> {
        self.0.reserve(offset, bytes)
    }

    /// What is known of it.
    ///
    /// # Errors
    /// As fstat(2).
    pub(crate) fn metadata(&self) -> io::Result<Metadata> {
        self.0.metadata()
    }

    /// Locks it for this process, until it is closed.
    ///
    /// # Errors
    /// As flock(2).
    pub(crate) fn try_lock(&self) -> Result<(), std::fs::TryLockError> {
        self.0.try_lock()
    }
}
