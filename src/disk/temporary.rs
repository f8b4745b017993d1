//! Names of files that are deleted unless they are renamed. `daemon/http/upload.rs` writes what arrives to such a file.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::{File, How, on_disk, remove_file};

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
