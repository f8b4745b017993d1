//! Statements of OBJ and MTL: lines, of which some are continued on the next. `obj` and `mtl` read them.

use std::io::{BufRead, BufReader};
use std::path::Path;

use super::source::{MAX_LINE_BYTES, Source};
use crate::text::plain_line;

/// The statements of a file.
pub(super) struct Statements {
    reader: BufReader<Source>,
    line: Vec<u8>,
    /// The line on which the last statement begins, counted from 1.
    begin: u64,
    /// Lines read.
    lines: u64,
    read_bytes: u64,
}

impl Statements {
    /// # Errors
    /// If the file cannot be opened.
    pub(super) fn open(path: &Path) -> std::io::Result<Self> {
        let reader = BufReader::with_capacity(64 << 10, Source::open(path)?);
        Ok(Self { reader, line: Vec::new(), begin: 0, lines: 0, read_bytes: 0 })
    }

    /// Length of the file, bytes.
    pub(super) fn total_bytes(&self) -> u64 {
        self.reader.get_ref().length
    }

    /// Bytes read so far.
    pub(super) fn read_bytes(&self) -> u64 {
        self.read_bytes
    }

    /// The line on which the last statement begins, counted from 1.
    pub(super) fn line(&self) -> u64 {
        self.begin
    }

    /// The next statement and its line, without white space around it; `None` at the end of the file.
    ///
    /// # Errors
    /// A text without the number of the line.
    pub(super) fn next(&mut self) -> Result<Option<(&[u8], u64)>, String> {
        self.line.clear();
        self.begin = self.lines + 1;
        loop {
            let begin = self.line.len();
            let count = self.reader.read_until(b'\n', &mut self.line).map_err(|error| error.to_string())?;
            self.read_bytes += count as u64;
            self.lines += u64::from(count > 0);
            if count == 0 && begin == 0 {
                return Ok(None);
            }
            let kept = self.line.trim_ascii_end().len();
            self.line.truncate(kept);
            if count == 0 || self.line.last() != Some(&b'\\') {
                return Ok(Some((self.line.trim_ascii_start(), self.begin)));
            }
            // A word may not go on there.
            self.line.pop();
            self.line.push(b' ');
            if self.line.len() > MAX_LINE_BYTES {
                return Err(format!("a line of more than {MAX_LINE_BYTES} bytes"));
            }
        }
    }
}

/// The key of a statement and what follows it.
pub(super) fn keyed(statement: &[u8]) -> (&[u8], &[u8]) {
    let end = statement.iter().position(u8::is_ascii_whitespace).unwrap_or(statement.len());
    let (key, rest) = statement.split_at(end);
    (key, rest.trim_ascii())
}

/// # Errors
/// If it is no text.
pub(super) fn text(statement: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(statement).map_err(|_| "it is no text; is it another kind of file?".into())
}

/// A number; `what` names it in errors.
///
/// # Errors
/// If it is none.
pub(super) fn number(word: &str, what: &str) -> Result<f64, String> {
    word.parse().map_err(|_| format!("{what}: `{}` is no number; export the part again", plain_line(word)))
}
