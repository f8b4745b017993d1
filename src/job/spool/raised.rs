//! Whether a plate was raised from below its clear height: noted on disk until the operator says that the plate is bare.

use std::fs;
use std::io::{self, Write};

use super::{Spool, SpoolError};
use crate::job::journal::sync_parent;
use crate::output::Output;

const RAISED: &str = "raised";
/// A height in micrometres as text takes less.
const MAX_TEXT_BYTES: usize = 16;

impl Spool {
    /// From where a plate was raised of which nobody has said since that it is bare, micrometres above the bottom of the vat.
    ///
    /// # Errors
    /// [`SpoolError::Io`]: the note cannot be read, or holds something else.
    pub fn raised_from_um(&self) -> Result<Option<i32>, SpoolError> {
        let path = self.root.join(RAISED);
        let text = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(super::io("read", &path)(error)),
        };
        let short = text.get(..MAX_TEXT_BYTES.min(text.len())).unwrap_or_default();
        let height = str::from_utf8(short).ok().and_then(|text| text.trim().parse().ok());
        height.map(Some).ok_or_else(|| {
            let error = io::Error::new(io::ErrorKind::InvalidData, "it does not hold a height in micrometres");
            super::io("read", &path)(error)
        })
    }

    /// Notes from where a plate was raised, micrometres; `None` once the operator has said that it is bare. On return that is on
    /// disk.
    ///
    /// # Errors
    /// [`SpoolError::Io`]; what was noted before stands then.
    pub fn set_raised(&self, from_um: Option<i32>) -> Result<(), SpoolError> {
        let path = self.root.join(RAISED);
        let written = match from_um {
            Some(from_um) => Output::create(&path).and_then(|output| {
                writeln!(output.file(), "{from_um}")?;
                output.persist()
            }),
            None => match fs::remove_file(&path) {
                Ok(()) => sync_parent(&path),
                Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
                Err(error) => Err(error),
            },
        };
        written.map_err(super::io("write", &path))
    }
}
