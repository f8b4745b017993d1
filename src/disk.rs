//! What must be known of a file system before it is written to.

use std::io;
use std::path::Path;

/// Space left free beyond what is being written: journals and the rest of the system live there too, and a full disk must not
/// end the print that is under way.
pub(crate) const RESERVE_BYTES: u64 = 16 << 20;

/// Bytes free for this user on the file system of `directory`.
///
/// # Errors
/// As statvfs(3): the directory does not exist or may not be looked at.
pub(crate) fn free_bytes(directory: &Path) -> io::Result<u64> {
    let space = rustix::fs::statvfs(directory)?;
    Ok(space.f_bavail.saturating_mul(space.f_frsize))
}
