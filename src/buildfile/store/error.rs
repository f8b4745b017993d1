//! Why a build file cannot be used: every function of [`BuildFile`](super::BuildFile) that reads returns it.

use std::path::PathBuf;

/// A build file cannot be used. Every message names the file.
#[derive(Debug, thiserror::Error)]
pub enum BuildFileError {
    /// The file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is not a build file, or has another version.
    #[error("{}: {problem}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What was found and what is expected.
        problem: String,
    },
    /// The frame (header, index, profile or footer) is damaged or contradicts itself.
    #[error("{}: {part}: {problem}; pack the part again or copy the file again", path.display())]
    Frame {
        /// The file.
        path: PathBuf,
        /// Which of them: `header`, `index`, `profile` or `footer`.
        part: &'static str,
        /// What is wrong.
        problem: String,
    },
    /// A chunk is damaged or contradicts index or header.
    #[error("{}: chunk {chunk} of {chunk_count}: {problem}; pack the part again or copy the file again", path.display())]
    Chunk {
        /// The file.
        path: PathBuf,
        /// Chunk number, from 0.
        chunk: usize,
        /// Number of chunks.
        chunk_count: usize,
        /// What is wrong.
        problem: String,
    },
}

impl BuildFileError {
    /// What is damaged and how, without the file name and without advice; `None` if the file is not damaged.
    pub fn damage(&self) -> Option<String> {
        match self {
            Self::Read { .. } | Self::Foreign { .. } => None,
            Self::Frame { part, problem, .. } => Some(format!("{part}: {problem}")),
            Self::Chunk { chunk, chunk_count, problem, .. } => {
                Some(format!("chunk {chunk} of {chunk_count}: {problem}"))
            }
        }
    }
}
