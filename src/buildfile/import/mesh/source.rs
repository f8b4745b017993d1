//! The file of a mesh as a library reads it: without lines that never end. It also computes the digest. `stl`, `obj`
//! and `ply` each have one.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use sha2::{Digest, Sha256};

use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;

/// Longest line of a text, and largest element of a binary file, bytes: libraries hold one in memory. It has room for a polygon of
/// thousands of corners. A line without end is no mesh.
pub(super) const MAX_LINE_BYTES: usize = 64 << 10;

/// A file that is being read.
pub(super) struct Source {
    file: File,
    pub(super) length: u64,
    /// Whether lines have a limit.
    pub(super) is_text: bool,
    /// What the reader gets in place of the first byte.
    pub(super) first: Option<u8>,
    at: u64,
    /// Bytes since the last end of a line.
    line_bytes: usize,
    /// A line was longer than the limit. A library that goes back and takes the file for another form gets the same error again.
    is_over: bool,
    digest: Sha256,
    /// Bytes in the digest. A library may read the beginning twice.
    digested: u64,
}

impl Source {
    /// Opens a file whose lines have a limit.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        let digest = Sha256::new();
        Ok(Self { file, length, is_text: true, first: None, at: 0, line_bytes: 0, is_over: false, digest, digested: 0 })
    }

    /// The first `most` bytes, or all if there are fewer. Reading begins anew after them.
    pub(super) fn head(&mut self, most: u64) -> io::Result<Vec<u8>> {
        let mut head = Vec::new();
        (&self.file).take(most).read_to_end(&mut head)?;
        self.seek(SeekFrom::Start(0))?;
        Ok(head)
    }

    /// Adds the digest of the whole file to the collector's.
    pub(super) fn finish(mut self, path: &Path, collector: &mut Collector<'_>) -> Result<(), PackError> {
        // A library may leave the end of the file unread.
        self.is_text = false;
        let mut buffer = vec![0; 64 << 10];
        let mut rest = || {
            self.seek(SeekFrom::Start(self.digested))?;
            while self.read(&mut buffer)? > 0 {}
            Ok(())
        };
        rest().map_err(|source| PackError::Read { path: path.into(), source })?;
        let (_, digest) = collector.parts();
        digest.update(self.digest.finalize());
        Ok(())
    }

    fn limit_lines(&mut self, bytes: &[u8]) -> io::Result<()> {
        for line in bytes.split_inclusive(|byte| *byte == b'\n') {
            self.line_bytes += line.len();
            self.is_over |= self.line_bytes > MAX_LINE_BYTES;
            if line.ends_with(b"\n") {
                self.line_bytes = 0;
            }
        }
        if self.is_over {
            let problem = format!("a line of more than {MAX_LINE_BYTES} bytes");
            return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
        }
        Ok(())
    }
}

impl Read for Source {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        let bytes = &mut buffer[..count];
        // What a reader skipped is not in the digest yet; `finish` reads it.
        if self.at <= self.digested {
            let known = (self.digested - self.at).min(count as u64) as usize;
            self.digest.update(&bytes[known..]);
            self.digested += (count - known) as u64;
        }
        if self.is_text {
            self.limit_lines(bytes)?;
        }
        if let (0, Some(first), Some(byte)) = (self.at, self.first, bytes.first_mut()) {
            *byte = first;
        }
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Source {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.line_bytes = 0;
        self.at = self.file.seek(to)?;
        Ok(self.at)
    }
}
