//! A text file in blocks of whole lines, read once from front to end. `edge_text` parses the blocks.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::line::{LineError, MAX_LINE_BYTES};
use crate::buildfile::error::PackError;

/// Length of a block: long enough that sending it to a thread takes no time in comparison, and small compared with the memory of the sort.
const BLOCK_BYTES: usize = 256 << 10;

/// Most bytes of padding after the end of a text: devices fill up to a sector or a block of a disk. A file of 10 GB that a copy has left
/// empty is no text.
const MAX_PADDING_BYTES: u64 = 1 << 20;

/// Whole lines. Only the last line of the file may lack a line end.
pub(super) struct Block {
    /// Number of the first line in the file, from 1.
    pub(super) first_line: u64,
    pub(super) bytes: Vec<u8>,
}

/// Reads blocks.
pub(super) struct Blocks<'a> {
    path: &'a Path,
    file: File,
    /// The beginning of a line at the end of the previous block.
    rest: Vec<u8>,
    next_line: u64,
    /// Whether the beginning of the file was checked.
    begun: bool,
    /// Bytes read so far.
    pub(super) done: u64,
}

impl<'a> Blocks<'a> {
    /// Opens a file.
    ///
    /// # Errors
    /// If the file cannot be opened.
    pub(super) fn open(path: &'a Path) -> Result<Self, PackError> {
        let file = File::open(path).map_err(|source| PackError::Read { path: path.into(), source })?;
        Ok(Self { path, file, rest: Vec::new(), next_line: 1, begun: false, done: 0 })
    }

    /// The next block; `None` at the end of the file. `digest` takes the bytes that were read.
    ///
    /// # Errors
    /// If the file cannot be read, is UTF-16, continues after its end mark, or a line is longer than a block.
    pub(super) fn next(&mut self, digest: &mut dyn FnMut(&[u8])) -> Result<Option<Block>, LineError> {
        let mut bytes = std::mem::take(&mut self.rest);
        let kept = bytes.len();
        bytes.reserve_exact(BLOCK_BYTES);
        let read = self.file.by_ref().take((BLOCK_BYTES - kept) as u64).read_to_end(&mut bytes);
        let at_line = |error| LineError { line: self.next_line, error };
        let count = read.map_err(|source| at_line(PackError::Read { path: self.path.into(), source }))?;
        digest(&bytes[kept..]);
        self.done += count as u64;
        let mut at_end = bytes.len() < BLOCK_BYTES;
        if !std::mem::replace(&mut self.begun, true) {
            self.check_encoding(&mut bytes)?;
        }
        // Old editors end a text with Ctrl-Z, and some devices pad it with NUL.
        let text = bytes.iter().rposition(|&byte| !is_padding(byte)).map_or(0, |last| last + 1);
        if let Some(mark) = bytes[text..].iter().position(|byte| !byte.is_ascii_whitespace()) {
            bytes.truncate(text + mark);
            self.read_padding(self.next_line + line_ends(&bytes), digest)?;
            at_end = true;
        }
        if bytes.is_empty() {
            return Ok(None);
        }
        if !at_end {
            // A CR at the very end may end a line or begin CR LF.
            let known = bytes.len() - usize::from(bytes.ends_with(b"\r"));
            let Some(end) = bytes[..known].iter().rposition(|byte| matches!(byte, b'\n' | b'\r')) else {
                let problem = format!("the line is longer than {MAX_LINE_BYTES} bytes; is this edge text?");
                return Err(LineError::at(self.path, self.next_line, &bytes, &problem));
            };
            self.rest = bytes.split_off(end + 1);
        }
        let first_line = self.next_line;
        self.next_line += line_ends(&bytes);
        Ok(Some(Block { first_line, bytes }))
    }

    /// Removes a UTF-8 byte-order mark, and refuses UTF-16.
    fn check_encoding(&self, bytes: &mut Vec<u8>) -> Result<(), LineError> {
        if bytes.starts_with(b"\xFF\xFE") || bytes.starts_with(b"\xFE\xFF") {
            let problem = "the file is UTF-16 text; save it as UTF-8 or plain ASCII";
            return Err(LineError { line: 1, error: PackError::input(self.path.display().to_string(), problem) });
        }
        if bytes.starts_with(b"\xEF\xBB\xBF") {
            bytes.drain(..3);
        }
        Ok(())
    }

    /// Reads the rest of a file after an end mark in `line`. Only padding may follow.
    fn read_padding(&mut self, line: u64, digest: &mut dyn FnMut(&[u8])) -> Result<(), LineError> {
        let mut bytes = vec![0; BLOCK_BYTES];
        let mut padding_bytes = 0;
        loop {
            let count = match self.file.read(&mut bytes) {
                Ok(0) => return Ok(()),
                Ok(count) => count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                Err(source) => {
                    return Err(LineError { line, error: PackError::Read { path: self.path.into(), source } });
                }
            };
            digest(&bytes[..count]);
            self.done += count as u64;
            padding_bytes += count as u64;
            if padding_bytes > MAX_PADDING_BYTES {
                let problem =
                    "more than 1 MiB of NUL or blanks follow the text; was it copied as a whole? Cut them off";
                return Err(LineError {
                    line,
                    error: PackError::input(format!("{}:{line}", self.path.display()), problem),
                });
            }
            if let Some(at) = bytes[..count].iter().position(|&byte| !is_padding(byte)) {
                let problem = "text follows after a NUL or Ctrl-Z, which end a text";
                return Err(LineError::at(self.path, line, &bytes[at..count], problem));
            }
        }
    }
}

/// Whether the byte may follow the last line.
fn is_padding(byte: u8) -> bool {
    const CTRL_Z: u8 = 0x1A;
    matches!(byte, 0 | CTRL_Z) || byte.is_ascii_whitespace()
}

/// Counts line ends (LF, CR LF or CR). Sums of one byte let the compiler use vector instructions.
fn line_ends(bytes: &[u8]) -> u64 {
    let Some((last, before)) = bytes.split_last() else { return 0 };
    let is_end = |(&byte, &next): (&u8, &u8)| u8::from(byte == b'\n') | u8::from(byte == b'\r' && next != b'\n');
    let sum = |(part, next): (&[u8], &[u8])| u64::from(part.iter().zip(next).map(is_end).sum::<u8>());
    let chunk = usize::from(u8::MAX);
    before.chunks(chunk).zip(bytes[1..].chunks(chunk)).map(sum).sum::<u64>() + u64::from(matches!(last, b'\n' | b'\r'))
}
