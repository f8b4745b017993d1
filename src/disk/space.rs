//! Space on a disk: how much is free, becomes free and stays free. `job/spool.rs` compares it with what a part needs.

use std::io;
use std::path::Path;

use super::on_disk;

/// Space that is kept free, bytes: journals and the rest of the system need it, and a full disk must not end a print that is under
/// way.
pub(crate) const RESERVE_BYTES: u64 = 16 << 20;

/// Bytes free for this user on the file system of `directory`.
///
/// # Errors
/// As statvfs(3): for example, the directory does not exist.
pub(crate) fn free_bytes(directory: &Path) -> io::Result<u64> {
    on_disk(|disk| disk.free_bytes(directory))
}

/// Space that becomes free if this name of a file is deleted, bytes: none if the file has other names.
pub(crate) fn freed_bytes(path: &Path) -> u64 {
    let found = on_disk(|disk| disk.metadata(path, false));
    found.map_or(0, |found| if found.links > 1 { 0 } else { found.allocated_bytes })
}
