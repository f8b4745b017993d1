//! Removes everything between the tags of an XML document while it is read: texts, comments, CDATA sections and processing instructions.
//! All geometry of 3MF is in attributes, and the XML parser would hold each of these in memory as a whole, whatever its length. `xml`
//! reads through it.

use std::io::{self, BufRead, BufReader, Read};

use quick_xml::parser::{ElementParser, Parser};

/// Longest tag, bytes: the parser holds it in memory. No tag of a lattice has a thousand bytes.
const MAX_TAG_BYTES: u64 = 1 << 20;

/// Buffer of the document, bytes.
const BUFFER_BYTES: usize = 64 << 10;

/// The tags of a document.
pub(super) struct Tags<R> {
    input: BufReader<R>,
    state: State,
    /// Number of bytes at the front of the input buffer that belong to the current tag.
    ready: usize,
    /// Bytes of the current tag that were returned so far.
    tag_bytes: u64,
    /// Bytes of the document read so far.
    position: u64,
}

enum State {
    /// Before the first byte.
    Begin,
    /// Between tags.
    Between,
    /// After a `<`. The next byte says what it opens.
    Opened,
    /// The `<` of a tag is to be returned next.
    Angle,
    /// Inside a tag.
    Tag(ElementParser),
    /// The `ready` bytes are the last of the tag.
    LastOfTag,
    /// After `<!`: the expected bytes, and how many of them have been read.
    Bang(&'static [u8], usize),
    /// Inside something that is removed. It ends with `wanted` times `mark` and then `>`. `run` marks precede the next byte.
    Dropped { mark: u8, wanted: usize, run: usize },
}

impl<R: Read> Tags<R> {
    pub(super) fn new(input: R) -> Self {
        let input = BufReader::with_capacity(BUFFER_BYTES, input);
        Self { input, state: State::Begin, ready: 0, tag_bytes: 0, position: 0 }
    }

    /// Bytes of the document read so far.
    pub(super) fn position_bytes(&self) -> u64 {
        self.position
    }

    /// Reads on until there are bytes to return, or the document ends.
    fn advance(&mut self) -> io::Result<()> {
        while self.ready == 0 && !matches!(self.state, State::Angle) {
            let buffer = self.input.fill_buf()?;
            if buffer.is_empty() {
                return match self.state {
                    State::Begin | State::Between | State::Tag(_) => Ok(()),
                    _ => Err(io::Error::other("the document ends inside a comment or section; it is truncated")),
                };
            }
            let used = match &mut self.state {
                State::Begin => {
                    if buffer.starts_with(b"\xFF\xFE") || buffer.starts_with(b"\xFE\xFF") {
                        return Err(io::Error::other("the document is UTF-16 text; only UTF-8 is read"));
                    }
                    self.state = State::Between;
                    0
                }
                State::Between => match memchr::memchr(b'<', buffer) {
                    Some(at) => {
                        self.state = State::Opened;
                        at + 1
                    }
                    None => buffer.len(),
                },
                State::Opened => self.state.open(buffer[0])?,
                State::Tag(parser) => {
                    let end = parser.feed(buffer);
                    self.ready = end.map_or(buffer.len(), |end| end + 1);
                    if self.tag_bytes + self.ready as u64 > MAX_TAG_BYTES {
                        let problem = format!("an element longer than {MAX_TAG_BYTES} bytes");
                        return Err(io::Error::other(problem));
                    }
                    if end.is_some() {
                        self.state = State::LastOfTag;
                    }
                    0
                }
                State::Bang(..) => self.state.name(buffer[0])?,
                State::Dropped { mark, wanted, run } => {
                    let (used, ended) = drop_bytes(buffer, *mark, *wanted, run);
                    if ended {
                        self.state = State::Between;
                    }
                    used
                }
                State::Angle | State::LastOfTag => 0,
            };
            self.input.consume(used);
            self.position += used as u64;
        }
        Ok(())
    }
}

impl State {
    /// Processes the byte after `<`. Returns the number of bytes used.
    fn open(&mut self, byte: u8) -> io::Result<usize> {
        *self = match byte {
            b'!' => Self::Bang(b"", 0),
            b'?' => Self::Dropped { mark: b'?', wanted: 1, run: 0 },
            _ => {
                *self = Self::Angle;
                return Ok(0);
            }
        };
        Ok(1)
    }

    /// Processes a byte after `<!`. Returns the number of bytes used.
    fn name(&mut self, byte: u8) -> io::Result<usize> {
        const COMMENT: &[u8] = b"--";
        const SECTION: &[u8] = b"[CDATA[";
        let Self::Bang(expected, matched) = self else { return Ok(0) };
        if expected.is_empty() {
            *expected = match byte {
                b'-' => COMMENT,
                b'[' => SECTION,
                b'D' => return Err(io::Error::other("a document type declaration, which 3MF forbids")),
                _ => return Err(io::Error::other("`<!` begins neither a comment nor a section")),
            };
        }
        if expected[*matched] != byte {
            return Err(io::Error::other("`<!` begins neither a comment nor a section"));
        }
        *matched += 1;
        if *matched == expected.len() {
            let mark = if *expected == COMMENT { b'-' } else { b']' };
            *self = Self::Dropped { mark, wanted: 2, run: 0 };
        }
        Ok(1)
    }
}

/// Counts the bytes at the front of `buffer` that are removed. Also returns whether the last of them ends the removed section.
fn drop_bytes(buffer: &[u8], mark: u8, wanted: usize, run: &mut usize) -> (usize, bool) {
    for (at, &byte) in buffer.iter().enumerate() {
        match byte {
            b'>' if *run >= wanted => return (at + 1, true),
            _ if byte == mark => *run += 1,
            _ => *run = 0,
        }
    }
    (buffer.len(), false)
}

impl<R: Read> Read for Tags<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(buffer)?;
        self.consume(count);
        Ok(count)
    }
}

impl<R: Read> BufRead for Tags<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.advance()?;
        match self.state {
            State::Angle => Ok(b"<"),
            _ => Ok(&self.input.buffer()[..self.ready]),
        }
    }

    fn consume(&mut self, count: usize) {
        match self.state {
            State::Angle if count > 0 => {
                self.state = State::Tag(ElementParser::Outside);
                self.tag_bytes = 1;
            }
            _ => {
                let count = count.min(self.ready);
                self.input.consume(count);
                self.ready -= count;
                self.position += count as u64;
                self.tag_bytes += count as u64;
                if self.ready == 0 && matches!(self.state, State::LastOfTag) {
                    self.state = State::Between;
                }
            }
        }
    }
}
