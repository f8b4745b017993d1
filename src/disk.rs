//! Files of the spool and of the configuration: opened without waiting, read up to a limit, written whole or not at all. Every access
//! of a running daemon to its spool passes here, and from here to [`system`]. `job/spool.rs` keeps its files with it.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

pub(crate) use crate::system::How;
use crate::system::{self, Disk, DiskFile, FileKind, Metadata};

/// Space that is kept free, bytes: journals and the rest of the system need it, and a full disk must not end a print that is under
/// way.
pub(crate) const RESERVE_BYTES: u64 = 16 << 20;

/// Calls `act` with the file system of this thread.
fn on_disk<R>(act: impl FnOnce(&dyn Disk) -> R) -> R {
    system::with(|system| act(system.disk()))
}

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
        regular(file.metadata()?)?;
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

/// What is at `path`; a symbolic link is followed.
///
/// # Errors
/// As stat(2).
pub(crate) fn metadata(path: &Path) -> io::Result<Metadata> {
    on_disk(|disk| disk.metadata(path, true))
}

/// Whether there is a directory at `path`.
pub(crate) fn is_directory(path: &Path) -> bool {
    metadata(path).is_ok_and(|found| found.kind == FileKind::Directory)
}

/// Whether there is anything at `path`.
pub(crate) fn exists(path: &Path) -> bool {
    metadata(path).is_ok()
}

/// Makes a directory; its parent must be there.
///
/// # Errors
/// As mkdir(2).
pub(crate) fn create_directory(path: &Path) -> io::Result<()> {
    on_disk(|disk| disk.create_directory(path))
}

/// Makes a directory and those above it, unless they are there. What was made is on disk then.
///
/// # Errors
/// As mkdir(2) and fsync(2).
pub(crate) fn create_directories(path: &Path) -> io::Result<()> {
    match create_directory(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let parent = path.parent().filter(|parent| *parent != Path::new("")).ok_or(error)?;
            create_directories(parent)?;
            create_directory(path)?;
        }
        Err(_) if is_directory(path) => return Ok(()),
        made => made?,
    }
    sync_parent(path)
}

/// What a directory holds, in any order.
///
/// # Errors
/// As opendir(3).
pub(crate) fn list(path: &Path) -> io::Result<Vec<PathBuf>> {
    on_disk(|disk| disk.list(path))
}

/// Renames a file or directory; a file of the new name is replaced.
///
/// # Errors
/// As rename(2).
pub(crate) fn rename(from: &Path, to: &Path) -> io::Result<()> {
    on_disk(|disk| disk.rename(from, to))
}

/// Deletes a file.
///
/// # Errors
/// As unlink(2).
pub(crate) fn remove_file(path: &Path) -> io::Result<()> {
    on_disk(|disk| disk.remove_file(path))
}

/// Deletes an empty directory.
///
/// # Errors
/// As rmdir(2).
pub(crate) fn remove_directory(path: &Path) -> io::Result<()> {
    on_disk(|disk| disk.remove_directory(path))
}

/// Deletes a file, or a directory with what it holds. A symbolic link is deleted, not what it leads to.
///
/// # Errors
/// As unlink(2) and rmdir(2).
pub(crate) fn remove_tree(path: &Path) -> io::Result<()> {
    if on_disk(|disk| disk.metadata(path, false))?.kind != FileKind::Directory {
        return remove_file(path);
    }
    list(path)?.iter().try_for_each(|path| remove_tree(path))?;
    remove_directory(path)
}

/// Space that becomes free if this name of a file is deleted, bytes: none if the file has other names.
pub(crate) fn freed_bytes(path: &Path) -> u64 {
    let found = on_disk(|disk| disk.metadata(path, false));
    found.map_or(0, |found| if found.links > 1 { 0 } else { found.allocated_bytes })
}

/// Flushes a directory: names made, changed and deleted in it are on disk then.
///
/// # Errors
/// As fsync(2).
pub(crate) fn sync_directory(path: &Path) -> io::Result<()> {
    on_disk(|disk| disk.sync_directory(path))
}

/// Flushes the directory of a file, so that the file's name survives a power cut.
///
/// # Errors
/// As fsync(2).
pub(crate) fn sync_parent(path: &Path) -> io::Result<()> {
    sync_directory(crate::output::directory_of(path))
}

/// Bytes free for this user on the file system of `directory`.
///
/// # Errors
/// As statvfs(3): for example, the directory does not exist.
pub(crate) fn free_bytes(directory: &Path) -> io::Result<u64> {
    on_disk(|disk| disk.free_bytes(directory))
}

/// Reads a small regular file.
///
/// # Errors
/// As [`File::open`], and if it has more than `max_bytes`.
pub(crate) fn read_small(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    read_up_to(&File::open(path, How::Read)?, max_bytes)
}

/// Reads an open file to its end.
///
/// # Errors
/// As read(2), and if more than `max_bytes` come.
pub(crate) fn read_up_to(file: &File, max_bytes: u64) -> io::Result<Vec<u8>> {
    /// Read at once.
    const PIECE_BYTES: usize = 4 << 10;
    let mut bytes = Vec::new();
    // The file may grow while it is read, so its length is not enough.
    loop {
        let from = bytes.len() as u64;
        if file.append_to(&mut bytes, from, PIECE_BYTES)? == 0 {
            return Ok(bytes);
        }
        if bytes.len() as u64 > max_bytes {
            return Err(io::Error::new(ErrorKind::InvalidData, format!("it has more than {max_bytes} bytes")));
        }
    }
}

/// Writes a small file that appears whole. On return it is on disk. On an error the earlier file of that name is unchanged, unless only
/// the final flush of the directory failed: then the new one is there, and may be lost in a power cut.
///
/// # Errors
/// As write(2) and rename(2).
pub(crate) fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let passing = passing(path);
    let write = || {
        let file = File::open(&passing, How::Truncate)?;
        file.write_all_at(bytes, 0)?;
        file.sync_all()?;
        rename(&passing, path)?;
        sync_parent(path)
    };
    write().inspect_err(|_| {
        // Best effort: the error that matters is the first one.
        let _ = remove_file(&passing);
    })
}

/// The name of a file that is being written to replace `path`: the same every time, so that a kill leaves no more than one behind.
fn passing(path: &Path) -> PathBuf {
    path.with_file_name(format!(".{}.tmp", path.file_name().unwrap_or_default().to_string_lossy()))
}

/// Deletes what a [`replace`] of `path` left that was interrupted by a kill.
///
/// # Errors
/// As unlink(2).
pub(crate) fn remove_unfinished(path: &Path) -> io::Result<()> {
    match remove_file(&passing(path)) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}

/// The name of a file that is deleted when this is dropped, unless it was renamed before.
#[derive(Debug)]
pub struct TempPath(PathBuf);

impl TempPath {
    /// Finds a name in `directory` for which `make` succeeds.
    ///
    /// # Errors
    /// Those of `make`, but for [`ErrorKind::AlreadyExists`].
    pub(crate) fn make<T>(
        directory: &Path,
        prefix: &str,
        make: impl Fn(&Path) -> io::Result<T>,
    ) -> io::Result<(Self, T)> {
        /// Two names of 64 random bits are the same once in an age; more tries mean that something else is wrong.
        const MAX_TRIES: usize = 8;
        let mut made = Err(ErrorKind::AlreadyExists.into());
        for _ in 0..MAX_TRIES {
            let path = directory.join(format!("{prefix}{:016x}.layerd", crate::random::bits()));
            made = make(&path).map(|made| (Self(path), made));
            if !made.as_ref().is_err_and(|error: &io::Error| error.kind() == ErrorKind::AlreadyExists) {
                break;
            }
        }
        made
    }

    /// A new file in `directory`, to write. Only this user may read it.
    ///
    /// # Errors
    /// As open(2).
    pub(crate) fn file_in(directory: &Path, prefix: &str) -> io::Result<(Self, File)> {
        Self::make(directory, prefix, |path| File::open(path, How::CreatePrivate))
    }

    /// A second name in `directory` for a file.
    ///
    /// # Errors
    /// As link(2).
    pub(crate) fn link_in(directory: &Path, prefix: &str, file: &Path) -> io::Result<Self> {
        Self::make(directory, prefix, |path| on_disk(|disk| disk.link(file, path))).map(|(path, ())| path)
    }
}

impl std::ops::Deref for TempPath {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Drop for TempPath {
    fn drop(&mut self) {
        // It may have been renamed.
        let _ = remove_file(&self.0);
    }
}
