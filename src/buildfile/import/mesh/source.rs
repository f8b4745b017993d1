//! The file of a mesh as a library reads it: without lines that never end. `stl`, `obj` and `ply` each have one.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

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
}

impl Source {
    /// Opens a file whose lines have a limit.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        Ok(Self { file, length, is_text: true, first: None, at: 0, line_bytes: 0, is_over: false })
    }

    /// The first `most` bytes, or all if there are fewer. Reading begins anew after them.
    pub(super) fn head(&mut self, most: u64) -> io::Result<Vec<u8>> {
        let mut head = Vec::new();
        (&self.file).take(most).read_to_end(&mut head)?;
        self.seek(SeekFrom::Start(0))?;
        Ok(head)
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
