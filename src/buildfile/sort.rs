//! Sorting more struts than memory holds: sorted runs in one nameless temporary file, then merged.
//!
//! The temporary file has no name from the start, so nothing stays behind whatever ends the process.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::chunk::node_key;
use super::model::{Cap, Caps, Strut};

/// Bytes of one strut in a run.
const RECORD_BYTES: usize = 33;

/// Least buffer for each run of a merge: below it, seeking costs more than reading. Sets how many runs are merged at once.
const RUN_BUFFER_BYTES: usize = 16 << 10;

/// Largest buffer for each run: beyond it nothing is gained.
const RUN_BUFFER_LIMIT_BYTES: usize = 1 << 20;

/// Sorts struts into file order within a number of bytes.
pub(super) struct Sorter {
    directory: PathBuf,
    memory_bytes: usize,
    buffer: Vec<Strut>,
    capacity: usize,
    spill: Option<Spill>,
}

impl Sorter {
    /// A sorter whose buffers take at most `memory_bytes` (at least room for two runs); spills go to `directory`.
    pub(super) fn new(directory: &Path, memory_bytes: u64) -> Self {
        let memory_bytes = usize::try_from(memory_bytes).unwrap_or(usize::MAX).max(4 * RUN_BUFFER_BYTES);
        Self {
            directory: directory.into(),
            memory_bytes,
            buffer: Vec::new(),
            // A growing vector holds its old and its new place for a moment: 1 + 2 parts.
            capacity: (memory_bytes / size_of::<Strut>()).max(1),
            spill: None,
        }
    }

    /// Adds one strut.
    ///
    /// # Errors
    /// Where a run cannot be written.
    pub(super) fn push(&mut self, strut: Strut) -> io::Result<()> {
        if self.buffer.len() == self.capacity {
            self.spill_run()?;
        }
        if self.buffer.len() == self.buffer.capacity() {
            let wanted = (2 * self.buffer.len()).clamp(4096, self.capacity.max(4096));
            self.buffer.reserve_exact(wanted - self.buffer.len());
        }
        self.buffer.push(strut);
        Ok(())
    }

    /// All struts in file order.
    ///
    /// # Errors
    /// Where runs cannot be written or read.
    pub(super) fn finish(mut self) -> io::Result<Sorted> {
        if self.spill.is_none() {
            self.buffer.sort_unstable_by_key(sort_key);
            return Ok(Sorted::InMemory(self.buffer.into_iter()));
        }
        self.spill_run()?;
        self.buffer = Vec::new();
        let fan_in = (self.memory_bytes / RUN_BUFFER_BYTES).max(2);
        let Some(mut spill) = self.spill else { return Ok(Sorted::InMemory(Vec::new().into_iter())) };
        while spill.runs.len() > fan_in {
            let mut next = Spill::create(&self.directory)?;
            for group in spill.runs.chunks(fan_in) {
                next.write_run(Merge::new(&spill.file, group, self.memory_bytes)?)?;
            }
            spill = next;
        }
        Ok(Sorted::Merged(Merge::new(&spill.file, &spill.runs, self.memory_bytes)?))
    }

    fn spill_run(&mut self) -> io::Result<()> {
        self.buffer.sort_unstable_by_key(sort_key);
        check_free_space(&self.directory, (self.buffer.len() * RECORD_BYTES) as u64)?;
        let spill = match &mut self.spill {
            Some(spill) => spill,
            none => none.insert(Spill::create(&self.directory)?),
        };
        spill.write_run(self.buffer.iter().copied().map(Ok))?;
        self.buffer.clear();
        Ok(())
    }
}

/// Refuses before writing where `bytes` do not fit the file system of `directory`.
///
/// # Errors
/// Says how much is needed and how much is free.
pub(super) fn check_free_space(directory: &Path, bytes: u64) -> io::Result<()> {
    let free = crate::disk::free_bytes(directory)?;
    if free >= bytes {
        return Ok(());
    }
    let text =
        format!("{} MiB more are needed, but {} MiB are free; make room or write elsewhere", bytes >> 20, free >> 20);
    Err(io::Error::new(io::ErrorKind::StorageFull, text))
}

/// The order of struts in a build file; total, so that a file does not depend on the order of its source.
fn sort_key(strut: &Strut) -> ([i32; 3], [i32; 3], [u32; 2], [u8; 2]) {
    let Strut { a, b, radius_a, radius_b, caps } = *strut;
    (node_key(a), node_key(b), [radius_a, radius_b], [caps.a as u8, caps.b as u8])
}

/// Struts in file order.
pub(super) enum Sorted {
    InMemory(std::vec::IntoIter<Strut>),
    Merged(Merge),
}

impl Iterator for Sorted {
    type Item = io::Result<Strut>;

    fn next(&mut self) -> Option<Self::Item> {
        match self {
            Self::InMemory(struts) => struts.next().map(Ok),
            Self::Merged(merge) => merge.next(),
        }
    }
}

/// Sorted runs, one behind another.
struct Spill {
    file: Rc<File>,
    runs: Vec<Run>,
    end: u64,
}

#[derive(Clone, Copy)]
struct Run {
    offset: u64,
    bytes: u64,
}

impl Spill {
    fn create(directory: &Path) -> io::Result<Self> {
        Ok(Self { file: Rc::new(tempfile::tempfile_in(directory)?), runs: Vec::new(), end: 0 })
    }

    fn write_run(&mut self, struts: impl Iterator<Item = io::Result<Strut>>) -> io::Result<()> {
        let mut out = BufWriter::with_capacity(RUN_BUFFER_BYTES, &*self.file);
        let mut bytes = 0;
        for strut in struts {
            out.write_all(&to_record(&strut?))?;
            bytes += RECORD_BYTES as u64;
        }
        out.flush()?;
        drop(out);
        self.runs.push(Run { offset: self.end, bytes });
        self.end += bytes;
        Ok(())
    }
}

/// Several runs as one, the least strut first.
pub(super) struct Merge {
    readers: Vec<RunReader>,
    heads: BinaryHeap<Reverse<Head>>,
}

type Head = (([i32; 3], [i32; 3], [u32; 2], [u8; 2]), usize);

impl Merge {
    fn new(file: &Rc<File>, runs: &[Run], memory_bytes: usize) -> io::Result<Self> {
        let buffer_bytes = (memory_bytes / runs.len().max(1)).clamp(RUN_BUFFER_BYTES, RUN_BUFFER_LIMIT_BYTES);
        let buffer_bytes = buffer_bytes / RECORD_BYTES * RECORD_BYTES;
        let readers =
            runs.iter().map(|&run| RunReader { file: Rc::clone(file), run, buffer_bytes, buffer: VecDeque::new() });
        let mut merge = Self { readers: readers.collect(), heads: BinaryHeap::with_capacity(runs.len()) };
        for number in 0..runs.len() {
            merge.refill(number)?;
        }
        Ok(merge)
    }

    fn refill(&mut self, number: usize) -> io::Result<()> {
        if let Some(strut) = self.readers[number].next_strut()? {
            self.heads.push(Reverse((sort_key(&strut), number)));
        }
        Ok(())
    }
}

impl Iterator for Merge {
    type Item = io::Result<Strut>;

    fn next(&mut self) -> Option<Self::Item> {
        let Reverse(((a, b, radii, caps), number)) = self.heads.pop()?;
        let strut = Strut {
            a: node_key(a),
            b: node_key(b),
            radius_a: radii[0],
            radius_b: radii[1],
            caps: Caps { a: cap(caps[0]), b: cap(caps[1]) },
        };
        Some(self.refill(number).map(|()| strut))
    }
}

struct RunReader {
    file: Rc<File>,
    run: Run,
    buffer_bytes: usize,
    buffer: VecDeque<u8>,
}

impl RunReader {
    fn next_strut(&mut self) -> io::Result<Option<Strut>> {
        if self.buffer.is_empty() {
            let length = (self.buffer_bytes as u64).min(self.run.bytes) as usize;
            if length == 0 {
                return Ok(None);
            }
            let mut bytes = Vec::from(std::mem::take(&mut self.buffer));
            bytes.resize(length, 0);
            self.file.read_exact_at(&mut bytes, self.run.offset)?;
            self.buffer = bytes.into();
            self.run = Run { offset: self.run.offset + length as u64, bytes: self.run.bytes - length as u64 };
        }
        let mut record = [0; RECORD_BYTES];
        record.iter_mut().zip(self.buffer.drain(..RECORD_BYTES)).for_each(|(to, from)| *to = from);
        Ok(Some(from_record(&record)))
    }
}

fn to_record(strut: &Strut) -> [u8; RECORD_BYTES] {
    let mut record = [0; RECORD_BYTES];
    let words = strut.a.into_iter().chain(strut.b).map(|word| word as u32).chain([strut.radius_a, strut.radius_b]);
    for (bytes, word) in record.chunks_exact_mut(4).zip(words) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    record[32] = strut.caps.a as u8 | (strut.caps.b as u8) << 4;
    record
}

fn from_record(record: &[u8; RECORD_BYTES]) -> Strut {
    let word = |k: usize| u32::from_le_bytes([record[4 * k], record[4 * k + 1], record[4 * k + 2], record[4 * k + 3]]);
    Strut {
        a: [0, 1, 2].map(|k| word(k) as i32),
        b: [3, 4, 5].map(|k| word(k) as i32),
        radius_a: word(6),
        radius_b: word(7),
        caps: Caps { a: cap(record[32] & 15), b: cap(record[32] >> 4) },
    }
}

fn cap(code: u8) -> Cap {
    match code {
        0 => Cap::Sphere,
        1 => Cap::Hemisphere,
        _ => Cap::Butt,
    }
}
