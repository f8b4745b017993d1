//! Edge text, as GPULatticeSlicer writes it: a first line `count radius convolution_radius kernel_size`, then one strut per line,
//! `x1 y1 z1 x2 y2 z2 [radius [material [material2]]]`, in millimetres and in any order: the names of the materials at both ends. Blank lines, and comment lines that begin with `#` or `//`, may be
//! anywhere. Lines end with LF, CR LF or CR.
//!
//! The calling thread reads blocks and computes the digest. Each lane of the collector has a thread that parses and sorts.
//! `tests/pack_text.rs` has examples.

mod blocks;
mod line;

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crossbeam::channel::{Receiver, Sender, bounded};
use sha2::Digest;

use self::blocks::{Block, Blocks};
use self::line::{Header, LineError, MAX_LINE_BYTES, Numbers, is_blank, line_length, lines, place};
use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::import::lane::Lane;
use crate::buildfile::progress::PackProgress;

/// Most blocks that wait for each thread: one, so that no thread idles while the next block is read.
const MAX_WAITING_BLOCKS: usize = 1;

/// Shortest line of a strut: `0 0 0 0 0 1` and a line end.
const MIN_LINE_BYTES: u64 = 12;

/// Reads one file.
///
/// # Errors
/// [`PackError`] names file and line, and repeats the line.
pub(super) fn import(
    path: &Path,
    collector: &mut Collector<'_>,
    progress: &mut dyn FnMut(PackProgress),
) -> Result<(), PackError> {
    let mut blocks = Blocks::open(path)?;
    let (header, block) = read_header(path, &mut blocks, collector).map_err(|failure| failure.error)?;
    if let Some(support_mm) = header.convolution_radius.filter(|radius| *radius > 0.0) {
        collector.stated_support(path.display().to_string(), support_mm);
    }
    // Do not trust the first line: a file cannot hold more struts than its length allows. A pipe has no length.
    let metadata = std::fs::metadata(path).map_err(|source| PackError::Read { path: path.into(), source })?;
    let total = metadata.len();
    let most = if metadata.is_file() { total / MIN_LINE_BYTES } else { u64::MAX };
    collector.expect(header.count.min(most), progress)?;

    let job = Job { path, header, failed: AtomicBool::new(false), seen: AtomicU64::new(0) };
    let mut report = |done| progress(PackProgress::Reading { done, total });
    let failure = job.run(block, &mut blocks, collector, &mut report).err();
    let seen = job.seen.load(Ordering::Relaxed);
    let count = job.header.count;
    // A surplus strut is an error, too, and may come before the one that was found.
    let last = match &failure {
        Some(LineError { line, error: PackError::Input { .. } }) => Some(*line),
        Some(_) => None,
        None => (seen > count).then_some(u64::MAX),
    };
    if let Some(failure) = last.and_then(|last| job.surplus(last)).or(failure) {
        return Err(failure.error);
    }
    if seen != count {
        let problem = format!("the first line announces {count} struts, but {seen} follow; is the file cut short?");
        return Err(PackError::input(path.display().to_string(), problem));
    }
    Ok(())
}

/// Reads the first line that is neither blank nor a comment. Returns it, and the rest of its block.
fn read_header(
    path: &Path,
    blocks: &mut Blocks<'_>,
    collector: &mut Collector<'_>,
) -> Result<(Header, Block), LineError> {
    let (_, digest) = collector.parts();
    while let Some(mut block) = blocks.next(&mut |bytes| digest.update(bytes))? {
        let (mut begin, mut number) = (0, block.first_line);
        while begin < block.bytes.len() {
            let rest = &block.bytes[begin..];
            let line = &rest[..line_length(rest)];
            begin += line.len();
            if !is_blank(line) {
                let header = Header::parse(line).map_err(|problem| LineError::at(path, number, line, &problem))?;
                block.bytes.drain(..begin);
                block.first_line = number + 1;
                return Ok((header, block));
            }
            number += 1;
        }
    }
    let problem = "the file is empty, or holds nothing but comments";
    Err(LineError { line: 1, error: PackError::input(path.display().to_string(), problem) })
}

/// One file that is being parsed by several threads.
struct Job<'a> {
    path: &'a Path,
    header: Header,
    /// A thread has found an error, so no further block needs to be read.
    failed: AtomicBool,
    /// Struts found so far.
    seen: AtomicU64,
}

impl Job<'_> {
    /// Parses `first` and all further blocks on the threads of the collector.
    fn run(
        &self,
        first: Block,
        blocks: &mut Blocks<'_>,
        collector: &mut Collector<'_>,
        report: &mut dyn FnMut(u64),
    ) -> Result<(), LineError> {
        let (lanes, digest) = collector.parts();
        let (sender, receiver) = bounded(lanes.len() * MAX_WAITING_BLOCKS);
        std::thread::scope(|scope| {
            let threads: Vec<_> = lanes
                .iter_mut()
                .map(|lane| {
                    let receiver = receiver.clone();
                    scope.spawn(move || self.work(&receiver, lane))
                })
                .collect();
            drop(receiver);
            let read = self.feed(first, blocks, &sender, &mut |bytes| digest.update(bytes), report);
            drop(sender);
            let parsed = threads
                .into_iter()
                .map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            let failures = parsed.chain([read]).filter_map(Result::err);
            failures.min_by_key(|failure| failure.line).map_or(Ok(()), Err)
        })
    }

    /// Reads blocks and sends them in order, until the file ends or parsing has failed.
    fn feed(
        &self,
        first: Block,
        blocks: &mut Blocks<'_>,
        sender: &Sender<Block>,
        digest: &mut dyn FnMut(&[u8]),
        report: &mut dyn FnMut(u64),
    ) -> Result<(), LineError> {
        let mut next = Some(first);
        while let Some(block) = next {
            // Sending fails if all threads have failed.
            if sender.send(block).is_err() || self.failed.load(Ordering::Relaxed) {
                break;
            }
            if self.seen.load(Ordering::Relaxed) > self.header.count {
                break;
            }
            next = blocks.next(digest)?;
            report(blocks.done);
        }
        Ok(())
    }

    /// Parses blocks into a lane. Blocks come in order, so blocks that this thread does not parse after an error come later in the file.
    fn work(&self, blocks: &Receiver<Block>, lane: &mut Lane<'_>) -> Result<(), LineError> {
        for block in blocks {
            let parsed = self.parse(&block, lane);
            self.failed.fetch_or(parsed.is_err(), Ordering::Relaxed);
            self.seen.fetch_add(parsed?, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Parses one block and returns its number of struts.
    fn parse(&self, block: &Block, lane: &mut Lane<'_>) -> Result<u64, LineError> {
        let (mut rest, mut line, mut count) = (block.bytes.as_slice(), block.first_line, 0);
        while !rest.is_empty() {
            let (numbers, length) = match Numbers::plain(rest) {
                Some(plain) => plain,
                None => self.parse_slowly(rest, line)?,
            };
            let problem = |problem: String| LineError::at(self.path, line, &rest[..length], &problem);
            if !numbers.is_empty() {
                if length > MAX_LINE_BYTES {
                    return Err(problem(too_long()));
                }
                let beam = numbers.strut(self.header.radius, lane.materials()).map_err(problem)?;
                lane.beam(&beam, &|| place(self.path, line)).map_err(|error| LineError { line, error })?;
                count += 1;
            }
            rest = &rest[length..];
            line += 1;
        }
        Ok(count)
    }

    /// Parses the first line of `rest`, with numbers in any notation. Returns the numbers and the length of the line.
    fn parse_slowly<'a>(&self, rest: &'a [u8], line: u64) -> Result<(Numbers<'a>, usize), LineError> {
        let length = line_length(rest);
        let text = &rest[..length];
        let is_long = length > MAX_LINE_BYTES && !is_blank(text);
        let numbers = if is_long { Err(too_long()) } else { Numbers::parse(text) };
        Ok((numbers.map_err(|problem| LineError::at(self.path, line, text, &problem))?, length))
    }

    /// The error of the first strut beyond the announced number, if there is one up to line `last`. The threads count struts in an
    /// arbitrary order, so this reads the file again: the error must not depend on the threads.
    fn surplus(&self, last: u64) -> Option<LineError> {
        // A pipe cannot be read twice.
        std::fs::metadata(self.path).ok().filter(std::fs::Metadata::is_file)?;
        let mut blocks = Blocks::open(self.path).ok()?;
        let mut lines_left = self.header.count.saturating_add(2);
        while let Ok(Some(block)) = blocks.next(&mut |_| {}) {
            for (text, line) in lines(&block.bytes).zip(block.first_line..) {
                lines_left -= u64::from(!is_blank(text));
                if line > last {
                    return None;
                }
                if lines_left == 0 {
                    let problem = format!("the first line announces {} struts, but there are more", self.header.count);
                    return Some(LineError::at(self.path, line, text, &problem));
                }
            }
        }
        None
    }
}

fn too_long() -> String {
    format!("the line is longer than {MAX_LINE_BYTES} bytes; is this edge text?")
}
