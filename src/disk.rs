//! Free space of a file system, and files that are opened without waiting and read up to a limit. `job/spool.rs` reads its files with it.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;

/// Space that is kept free, bytes: journals and the rest of the system need it, and a full disk must not end a print that is under
/// way.
pub(crate) const RESERVE_BYTES: u64 = 16 << 20;

/// Bytes free for this user on the file system of `directory`.
///
/// # Errors
/// As statvfs(3): for example, the directory does not exist.
pub(crate) fn free_bytes(directory: &Path) -> io::Result<u64> {
    let space = rustix::fs::statvfs(directory)?;
    Ok(space.f_bavail.saturating_mul(space.f_frsize))
}

/// Opens a regular file, or a link to one. Never waits for the other end of a pipe, and does not open devices.
///
/// # Errors
/// As open(2), and if there is something else at `path`.
pub(crate) fn open_regular(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    let regular = |is_file: bool| if is_file { Ok(()) } else { Err(io::Error::other("it is not a regular file")) };
    // Before it is opened: opening a device can have effects. A file that `options` creates is not there yet.
    match std::fs::metadata(path) {
        Ok(metadata) => regular(metadata.is_file())?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    // For regular files the flag means nothing. A pipe put in place since then does not block.
    let file = options.custom_flags(OFlags::NONBLOCK.bits() as i32).open(path)?;
    regular(file.metadata()?.is_file())?;
    Ok(file)
}

/// Reads a small regular file.
///
/// # Errors
/// As [`open_regular`], and if it has more than `max_bytes`.
pub(crate) fn read_small(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    read_up_to(&open_regular(path, OpenOptions::new().read(true))?, max_bytes)
}

/// Reads an open file to its end.
///
/// # Errors
/// As read(2), and if more than `max_bytes` come.
pub(crate) fn read_up_to(file: &File, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    // The file may grow while it is read, so its length is not enough.
    file.take(max_bytes + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(io::Error::new(io::ErrorKind::InvalidData, format!("it has more than {max_bytes} bytes")));
    }
    Ok(bytes)
}
