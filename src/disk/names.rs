//! Names of files and directories: what is there, making, renaming, deleting and flushing them. `job/spool.rs` does all of it.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::on_disk;
use crate::system::{FileKind, Metadata};

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
        // It may be there already. If that cannot be seen, the reason says more than "File exists".
        Err(error) => match metadata(path) {
            Ok(found) if found.kind == FileKind::Directory => return Ok(()),
            Err(unseen) if error.kind() == ErrorKind::AlreadyExists => return Err(unseen),
            _ => return Err(error),
        },
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
