//! Small files: read up to a limit, written whole or not at all. `job/spool/raised.rs` keeps such a file.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::{File, How, remove_file, rename, sync_parent};

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
fn read_up_to(file: &File, max_bytes: u64) -> io::Result<Vec<u8>> {
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
