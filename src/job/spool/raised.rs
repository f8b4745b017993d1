//! Remembers on disk that the plate was raised from below its clear height, until the operator confirms that it is empty.
//! Tested by `tests/plate.rs`.

use std::io;

use super::{Spool, SpoolError};
use crate::disk;

const RAISED: &str = "raised";
/// A height in micrometres is shorter as text.
const MAX_TEXT_BYTES: u64 = 16;

impl Spool {
    /// Height from which the plate was raised, micrometres above the bottom of the vat. `None` if it was not, or was confirmed to be
    /// empty since.
    ///
    /// # Errors
    /// [`SpoolError::Io`] if the note cannot be read or does not hold a height.
    pub fn raised_from_um(&self) -> Result<Option<i32>, SpoolError> {
        let path = self.root.join(RAISED);
        let text = match disk::read_small(&path, MAX_TEXT_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(super::io("read", &path)(error)),
        };
        let height = str::from_utf8(&text).ok().and_then(|text| text.trim().parse().ok());
        height.map(Some).ok_or_else(|| {
            let error = io::Error::new(io::ErrorKind::InvalidData, "it does not hold a height in micrometres");
            super::io("read", &path)(error)
        })
    }

    /// Deletes what an interrupted [`Spool::set_raised`] left.
    pub(super) fn clear_raised(&self) -> Result<(), SpoolError> {
        let path = self.root.join(RAISED);
        disk::remove_unfinished(&path).map_err(super::io("delete", &path))
    }

    /// Notes the height from which the plate was raised, micrometres; `None` once it is confirmed to be empty. On return the note is
    /// on disk.
    ///
    /// # Errors
    /// [`SpoolError::Io`]; the earlier note stays then.
    pub fn set_raised(&self, from_um: Option<i32>) -> Result<(), SpoolError> {
        let path = self.root.join(RAISED);
        let written = match from_um {
            Some(from_um) => disk::replace(&path, format!("{from_um}\n").as_bytes()),
            None => match disk::remove_file(&path) {
                Ok(()) => disk::sync_parent(&path),
                Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
                Err(error) => Err(error),
            },
        };
        written.map_err(super::io("write", &path))
    }
}
