//! Why a build file could not be made.

use std::path::PathBuf;

use super::store::WriteError;

/// Why packing failed. Nothing half-written stays behind.
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// A source cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A source holds what cannot be printed.
    #[error("{place}: {problem}")]
    Input {
        /// File, and line or object.
        place: String,
        /// What was found, what is allowed, and the remedy.
        problem: String,
    },
    /// An option is out of range.
    #[error("{0}")]
    Option(String),
    /// Sorting out of core failed.
    #[error("cannot write beside the build file, in {}: {source}", directory.display())]
    Sort {
        /// Where runs are spilled: beside the build file.
        directory: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The build file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl PackError {
    /// An [`PackError::Input`].
    pub(super) fn input(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Input { place: place.into(), problem: problem.into() }
    }
}
