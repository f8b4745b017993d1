//! A text file in blocks of whole lines, read once from front to end.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::line::{LINE_LIMIT_BYTES, LineError};
use crate::buildfile::pack::PackError;

/// Length of a block: enough that handing it to a thread costs nothing, little beside the memory of the sort.
const BLOCK_BYTES: usize = 256 << 10;

/// Whole lines; only the file's last one may lack its newline.
pub(super) struct Block {
    /// Number of the first line in the file, from 1.
    pub(super) first_line: u64,
    pub(super) bytes: Vec<u8>,
}

/// Reads blocks.
pub(super) struct Blocks<'a> {
    path: &'a Path,
    file: File,
    /// The beginning of a line that the block before ended in.
    rest: Vec<u8>,
    next_line: u64,
    /// Bytes read so far.
    pub(super) done: u64,
}

impl<'a> Blocks<'a> {
    /// # Errors
    /// Where the file cannot be opened.
    pub(super) fn open(path: &'a Path) -> Result<Self, PackError> {
        let file = File::open(path).map_err(|source| PackError::Read { path: path.into(), source })?;
        Ok(Self { path, file, rest: Vec::new(), next_line: 1, done: 0 })
    }

    /// The next block; `None` at the end of the file. `digest` takes the bytes that were read for it.
    ///
    /// # Errors
    /// Where the file cannot be read, or a line is longer than a block.
    pub(super) fn next(&mut self, digest: &mut dyn FnMut(&[u8])) -> Result<Option<Block>, LineError> {
        let mut bytes = std::mem::take(&mut self.rest);
        let kept = bytes.len();
        bytes.reserve_exact(BLOCK_BYTES);
        let read = self.file.by_ref().take((BLOCK_BYTES - kept) as u64).read_to_end(&mut bytes);
        let at_line = |error| LineError { line: self.next_line, error };
        let count = read.map_err(|source| at_line(PackError::Read { path: self.path.into(), source }))?;
        digest(&bytes[kept..]);
        self.done += count as u64;
        if bytes.is_empty() {
            return Ok(None);
        }
        let at_end = bytes.len() < BLOCK_BYTES;
        if !at_end {
            let Some(end) = bytes.iter().rposition(|&byte| byte == b'\n') else {
                let problem = format!("the line is longer than {LINE_LIMIT_BYTES} bytes; is this edge text?");
                return Err(LineError::at(self.path, self.next_line, &bytes, &problem));
            };
            self.rest = bytes.split_off(end + 1);
        }
        let first_line = self.next_line;
        self.next_line += newlines(&bytes);
        Ok(Some(Block { first_line, bytes }))
    }
}

/// Counts line ends, in sums of one byte, of which a vector holds many.
fn newlines(bytes: &[u8]) -> u64 {
    let sum = |part: &[u8]| part.iter().map(|&byte| u8::from(byte == b'\n')).sum::<u8>();
    bytes.chunks(u8::MAX.into()).map(|part| u64::from(sum(part))).sum()
}
