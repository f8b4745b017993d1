//! Files of the spool and of the configuration: opened without waiting, read up to a limit, written whole or not at all. Every access
//! of a running daemon to its spool passes here, and from here to [`system`]. `job/spool.rs` keeps its files with it.

mod file;
mod names;
mod small;
mod space;
mod temporary;

pub(crate) use self::file::File;
pub(crate) use self::names::{
    create_directories, create_directory, exists, is_directory, list, metadata, remove_directory, remove_file,
    remove_tree, rename, sync_directory, sync_parent,
};
pub(crate) use self::small::{read_small, remove_unfinished, replace};
pub(crate) use self::space::{RESERVE_BYTES, free_bytes, freed_bytes};
pub use self::temporary::TempPath;
pub(crate) use crate::system::How;
use crate::system::{self, Disk};

/// Calls `act` with the file system of this thread.
fn on_disk<R>(act: impl FnOnce(&dyn Disk) -> R) -> R {
    system::with(|system| act(system.disk()))
}
