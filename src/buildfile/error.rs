//! Why a build file could not be made: [`pack`](super::pack) and [`generate`](super::generate) return it.

use std::path::PathBuf;

use super::store::WriteError;

/// Packing failed. No file stays behind.
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// A source could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A source contains something that cannot be packed.
    #[error("{place}: {problem}")]
    Input {
        /// File, and line or object.
        place: String,
        /// What was found, what is allowed, and what to do.
        problem: String,
    },
    /// An option is out of range.
    #[error("{0}")]
    Option(String),
    /// The temporary file of the sort could not be written or read.
    #[error("cannot write beside the build file, in {}: {source}", directory.display())]
    Sort {
        /// Directory of the temporary file: that of the build file.
        directory: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The build file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl PackError {
    /// A [`PackError::Input`].
    pub(super) fn input(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Input { place: place.into(), problem: problem.into() }
    }
}
