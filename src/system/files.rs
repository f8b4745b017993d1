//! Files as the daemon uses them, and those of the operating system. `disk/mod.rs` has the functions that the daemon's modules call.

use std::fmt::Debug;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::{FallocateFlags, OFlags};

/// A file system.
pub trait Disk {
    /// Opens a file. Never waits for the other end of a pipe.
    ///
    /// # Errors
    /// As open(2).
    fn open(&self, path: &Path, how: How) -> io::Result<Box<dyn DiskFile>>;

    /// What is at `path`; a symbolic link is followed if `follow` is set.
    ///
    /// # Errors
    /// As stat(2).
    fn metadata(&self, path: &Path, follow: bool) -> io::Result<Metadata>;

    /// Makes a directory; its parent must be there.
    ///
    /// # Errors
    /// As mkdir(2).
    fn create_directory(&self, path: &Path) -> io::Result<()>;

    /// What a directory holds, in any order.
    ///
    /// # Errors
    /// As opendir(3).
    fn list(&self, path: &Path) -> io::Result<Vec<PathBuf>>;

    /// Renames a file or directory; a file of the new name is replaced.
    ///
    /// # Errors
    /// As rename(2).
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Gives a file a second name.
    ///
    /// # Errors
    /// As link(2).
    fn link(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Deletes a file.
    ///
    /// # Errors
    /// As unlink(2).
    fn remove_file(&self, path: &Path) -> io::Result<()>;

    /// Deletes an empty directory.
    ///
    /// # Errors
    /// As rmdir(2).
    fn remove_directory(&self, path: &Path) -> io::Result<()>;

    /// Flushes a directory: names made, changed and deleted in it are on disk then.
    ///
    /// # Errors
    /// As fsync(2).
    fn sync_directory(&self, path: &Path) -> io::Result<()>;

    /// Bytes free for this user on the file system of a directory.
    ///
    /// # Errors
    /// As statvfs(3).
    fn free_bytes(&self, directory: &Path) -> io::Result<u64>;
}

/// An open file. Every read and write states its place.
pub trait DiskFile: Debug + Send + Sync {
    /// Reads some bytes from `offset` on; 0 at the end.
    ///
    /// # Errors
    /// As pread(2).
    fn read_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<usize>;

    /// Writes some of `bytes` from `offset` on.
    ///
    /// # Errors
    /// As pwrite(2).
    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize>;

    /// Cuts or extends the file, and releases space beyond its end.
    ///
    /// # Errors
    /// As ftruncate(2).
    fn set_len(&self, bytes: u64) -> io::Result<()>;

    /// Flushes content and length; with `metadata`, the rest of the file's metadata too.
    ///
    /// # Errors
    /// As fsync(2).
    fn sync(&self, metadata: bool) -> io::Result<()>;

    /// Sets space aside for the bytes from `offset` on, also beyond the file's end. The length stays.
    ///
    /// # Errors
    /// As fallocate(2).
    fn reserve(&self, offset: u64, bytes: u64) -> io::Result<()>;

    /// What is known of the open file.
    ///
    /// # Errors
    /// As fstat(2).
    fn metadata(&self) -> io::Result<Metadata>;

    /// Locks the file for this process, until it is closed.
    ///
    /// # Errors
    /// As flock(2); [`TryLockError::WouldBlock`] if another process has the lock.
    fn try_lock(&self) -> Result<(), TryLockError>;
}

/// How a file is opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum How {
    /// To read.
    Read,
    /// To read and write.
    ReadWrite,
    /// To write; made if it is not there.
    Create,
    /// To write; it must not be there.
    CreateNew,
    /// As `CreateNew`, and only this user may read it: for parts that people upload.
    CreatePrivate,
    /// To write from an empty file on; made if it is not there.
    Truncate,
}

/// What something on a disk is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A regular file.
    File,
    /// A directory.
    Directory,
    /// A pipe, a device, a socket, or a symbolic link that was not followed.
    Other,
}

/// What is known of something on a disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metadata {
    /// What it is.
    pub kind: FileKind,
    /// Length of a file, bytes.
    pub length_bytes: u64,
    /// Space that it takes, bytes.
    pub allocated_bytes: u64,
    /// Number of its names.
    pub links: u64,
    /// Two names with the same identity are one file.
    pub identity: (u64, u64),
}

impl From<fs::Metadata> for Metadata {
    fn from(found: fs::Metadata) -> Self {
        /// Unit of [`MetadataExt::blocks`].
        const BLOCK_BYTES: u64 = 512;
        let kind = match found.file_type() {
            kind if kind.is_file() => FileKind::File,
            kind if kind.is_dir() => FileKind::Directory,
            _ => FileKind::Other,
        };
        Self {
            kind,
            length_bytes: found.len(),
            allocated_bytes: found.blocks() * BLOCK_BYTES,
            links: found.nlink(),
            identity: (found.dev(), found.ino()),
        }
    }
}

/// The file systems of the operating system.
pub(super) struct RealDisk;

impl Disk for RealDisk {
    fn open(&self, path: &Path, how: How) -> io::Result<Box<dyn DiskFile>> {
        let mut options = OpenOptions::new();
        match how {
            How::Read => options.read(true),
            How::ReadWrite => options.read(true).write(true),
            How::Create => options.write(true).create(true).truncate(false),
            How::CreateNew => options.write(true).create_new(true),
            How::CreatePrivate => options.write(true).create_new(true).mode(0o600),
            How::Truncate => options.write(true).create(true).truncate(true),
        };
        // For regular files the flag means nothing. A pipe does not block.
        let file = options.custom_flags(OFlags::NONBLOCK.bits() as i32).open(path)?;
        Ok(Box::new(file))
    }

    fn metadata(&self, path: &Path, follow: bool) -> io::Result<Metadata> {
        let found = if follow { fs::metadata(path)? } else { fs::symlink_metadata(path)? };
        Ok(found.into())
    }

    fn create_directory(&self, path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    fn list(&self, path: &Path) -> io::Result<Vec<PathBuf>> {
        fs::read_dir(path)?.map(|entry| Ok(entry?.path())).collect()
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::hard_link(from, to)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn remove_directory(&self, path: &Path) -> io::Result<()> {
        fs::remove_dir(path)
    }

    fn sync_directory(&self, path: &Path) -> io::Result<()> {
        File::open(path)?.sync_all()
    }

    fn free_bytes(&self, directory: &Path) -> io::Result<u64> {
        let space = rustix::fs::statvfs(directory)?;
        Ok(space.f_bavail.saturating_mul(space.f_frsize))
    }
}

impl DiskFile for File {
    fn read_at(&self, bytes: &mut [u8], offset: u64) -> io::Result<usize> {
        FileExt::read_at(self, bytes, offset)
    }

    fn write_at(&self, bytes: &[u8], offset: u64) -> io::Result<usize> {
        FileExt::write_at(self, bytes, offset)
    }

    fn set_len(&self, bytes: u64) -> io::Result<()> {
        Self::set_len(self, bytes)
    }

    fn sync(&self, metadata: bool) -> io::Result<()> {
        if metadata { self.sync_all() } else { self.sync_data() }
    }

    fn reserve(&self, offset: u64, bytes: u64) -> io::Result<()> {
        Ok(rustix::fs::fallocate(self, FallocateFlags::KEEP_SIZE, offset, bytes)?)
    }

    fn metadata(&self) -> io::Result<Metadata> {
        Ok(Self::metadata(self)?.into())
    }

    fn try_lock(&self) -> Result<(), TryLockError> {
        Self::try_lock(self)
    }
}
