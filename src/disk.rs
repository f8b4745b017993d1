//! Free space of a file system.

use std::io;
use std::path::Path;

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
