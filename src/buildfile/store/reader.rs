//! Reading: [`BuildFile::open`] checks the frame, [`BuildFile::read_chunk`] each chunk. Nothing is taken on the file's word.

use std::cell::RefCell;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::chunk::{self, CHUNK_STRUTS, UNPACKED_LIMIT_BYTES};
use super::format::{self, Footer, HEADER_LIMIT_BYTES, OLD_VERSION, PRELUDE_BYTES, VERSION, check_beginning};
use super::index::ChunkEntry;
use super::lowest::LowestOfUnion;
use super::profile::{self, ProfileBuilder};
use crate::buildfile::model::{Blend, Bounds, Header, Strut};
use crate::codec;

/// A build file that cannot be used; every text names the file.
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
    /// Not a build file, or one of another version.
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
        /// Which part.
        part: &'static str,
        /// What is wrong.
        problem: String,
    },
    /// One chunk is damaged or contradicts index or header.
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
    /// What is damaged and how, without the file's name and without a remedy; `None` where the file is not damaged.
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

/// An open build file. Reading is thread-safe: every read states its place.
#[derive(Debug)]
pub struct BuildFile {
    path: PathBuf,
    file: File,
    file_bytes: u64,
    version: u32,
    header: Header,
    chunks: Vec<ChunkEntry>,
    peak_active: u64,
}

/// Buffers one thread needs to read chunks.
#[derive(Default)]
struct ReadScratch {
    packed: Vec<u8>,
    unpacked: Vec<u8>,
    columns: chunk::Scratch,
    decompressor: Option<zstd::bulk::Decompressor<'static>>,
}

thread_local! {
    static SCRATCH: RefCell<ReadScratch> = RefCell::default();
}

impl BuildFile {
    /// Opens a build file and checks its header, index and profile; chunks are checked as they are read.
    ///
    /// # Errors
    /// [`BuildFileError`] says what is wrong and where.
    pub fn open(path: &Path) -> Result<Self, BuildFileError> {
        let read_error = |source| BuildFileError::Read { path: path.into(), source };
        // Before it is opened: a pipe that nobody writes to would be waited for.
        let metadata = std::fs::metadata(path).map_err(read_error)?;
        if !metadata.is_file() {
            return Err(BuildFileError::Foreign { path: path.into(), problem: "it is not a regular file".into() });
        }
        Self::of(path, File::open(path).map_err(read_error)?)
    }

    /// The same of an open file, which `path` names in errors.
    pub(super) fn of(path: &Path, file: File) -> Result<Self, BuildFileError> {
        let metadata = file.metadata().map_err(|source| BuildFileError::Read { path: path.into(), source })?;
        let mut opening = Opening { path, file: &file, file_bytes: metadata.len(), header_end: 0 };
        let (version, header) = opening.header()?;
        let (chunks, peak_active) = opening.index(&header)?;
        Ok(Self { path: path.into(), file, file_bytes: metadata.len(), version, header, chunks, peak_active })
    }

    /// The file's name as it was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file.
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// What the file holds.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The chunks in ascending order of their lowest node z.
    pub fn chunks(&self) -> &[ChunkEntry] {
        &self.chunks
    }

    /// Reads chunk `index`, appending its struts to `out` in ascending order of their lower node.
    ///
    /// # Errors
    /// [`BuildFileError`] where the chunk is damaged; `out` is as before then.
    ///
    /// # Panics
    /// Where `index` is not below `chunks().len()`.
    pub fn read_chunk(&self, index: usize, out: &mut Vec<Strut>) -> Result<(), BuildFileError> {
        let entry = &self.chunks[index];
        SCRATCH.with_borrow_mut(|scratch| {
            let ReadScratch { packed, unpacked, columns, decompressor } = scratch;
            packed.clear();
            packed.reserve_exact(entry.packed_bytes as usize);
            packed.resize(entry.packed_bytes as usize, 0);
            self.file
                .read_exact_at(packed, entry.offset)
                .map_err(|source| BuildFileError::Read { path: self.path.clone(), source })?;
            unpack(packed, entry, decompressor, unpacked)
                .and_then(|()| chunk::decode(unpacked, &self.header, entry, columns, out))
                .map_err(|problem| BuildFileError::Chunk {
                    path: self.path.clone(),
                    chunk: index,
                    chunk_count: self.chunks.len(),
                    problem,
                })
        })
    }

    /// Reads every chunk once and compares what the header and the profile say with its struts: whoever prints the file wants
    /// to know of damage in the middle before the first layer. Takes about as long as reading the file.
    ///
    /// # Errors
    /// [`BuildFileError`] names the first damaged chunk, or what the struts contradict.
    pub fn verify(&self) -> Result<(), BuildFileError> {
        let Header { bounds, radius_range, .. } = self.header;
        let frame = |part, problem| BuildFileError::Frame { path: self.path.clone(), part, problem };
        let reach = self.header.reach_quanta();
        let (mut found, mut radii, mut profile) = (Bounds::EMPTY, [u32::MAX, 0], ProfileBuilder::default());
        let mut lowest = LowestOfUnion::default();
        let mut struts = Vec::new();
        for index in 0..self.chunks.len() {
            struts.clear();
            self.read_chunk(index, &mut struts)?;
            for strut in &struts {
                let beyond = || frame("header", format!("{strut:?} reaches beyond ±2³¹ quanta"));
                found = found.with(strut).ok_or_else(beyond)?;
                let [least, most] = [strut.radius_a.min(strut.radius_b), strut.radius_a.max(strut.radius_b)];
                radii = [radii[0].min(least), radii[1].max(most)];
                profile.add(i64::from(strut.a[2]) - reach, i64::from(strut.b[2]) + reach);
                lowest.add(strut);
            }
        }
        if (found, radii) != (bounds, radius_range) {
            return Err(frame(
                "header",
                format!("it says {bounds:?} and radii {radius_range:?}, but the struts have {found:?} and {radii:?}"),
            ));
        }
        let (stated_um, lowest_um) = (self.header.bottom_um, lowest.um(self.header.quantum_um));
        if self.version == VERSION && self.header.blend == Blend::Union && stated_um != lowest_um {
            return Err(frame(
                "header",
                format!("it says that the lowest solid point lies at {stated_um} µm, but it lies at {lowest_um} µm"),
            ));
        }
        let (promised, peak) = (self.peak_active, profile.peak_active());
        if peak > promised {
            return Err(frame(
                "profile",
                format!("it promises {promised} active struts at most, but there are {peak}"),
            ));
        }
        Ok(())
    }

    /// Most struts active at any one z: those with `z_low − reach ≤ z ≤ z_high + reach`. An upper bound, exact but for
    /// struts that begin and end in the same of at most 4096 slabs of the part's height.
    pub fn peak_active(&self) -> u64 {
        self.peak_active
    }

    /// Bytes this value holds for as long as it is open.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>()
            + self.path.capacity()
            + self.header.source_name.capacity()
            + self.chunks.capacity() * size_of::<ChunkEntry>()
    }

    /// Bytes each thread that reads chunks holds besides, at most: packed and unpacked bytes, node table and columns, and
    /// the decompressor's state (about 160 KiB).
    pub fn scratch_bytes(&self) -> usize {
        let largest = |length: fn(&ChunkEntry) -> u32| self.chunks.iter().map(length).max().unwrap_or(0) as usize;
        let struts = largest(|entry| entry.strut_count);
        largest(|entry| entry.packed_bytes)
            + largest(|entry| entry.unpacked_bytes)
            + chunk::Scratch::bytes(struts)
            + (160 << 10)
    }
}

fn unpack(
    packed: &[u8],
    entry: &ChunkEntry,
    decompressor: &mut Option<zstd::bulk::Decompressor<'static>>,
    out: &mut Vec<u8>,
) -> Result<(), String> {
    if crc32fast::hash(packed) != entry.crc {
        return Err("it is corrupt (CRC)".into());
    }
    let length = entry.unpacked_bytes as usize;
    out.clear();
    out.reserve_exact(length);
    let decompressor = match decompressor {
        Some(decompressor) => decompressor,
        none => none.insert(zstd::bulk::Decompressor::new().map_err(|error| error.to_string())?),
    };
    decompressor.decompress_to_buffer(packed, out).map_err(|error| format!("it does not decompress: {error}"))?;
    if out.len() != length {
        return Err(format!("it unpacks to {} bytes instead of {length}", out.len()));
    }
    Ok(())
}

/// A file whose frame is being read.
struct Opening<'a> {
    path: &'a Path,
    file: &'a File,
    file_bytes: u64,
    /// Where the header ends and the first chunk begins.
    header_end: u64,
}

impl Opening<'_> {
    fn header(&mut self) -> Result<(u32, Header), BuildFileError> {
        let foreign = |problem: String| BuildFileError::Foreign { path: self.path.into(), problem };
        if self.file_bytes < PRELUDE_BYTES as u64 {
            return Err(foreign(format!("{} bytes are too few for a build file (.layerd)", self.file_bytes)));
        }
        let prelude = self.read(0, PRELUDE_BYTES)?;
        check_beginning(&prelude).map_err(foreign)?;
        let word = |at: usize| u32::from_le_bytes([prelude[at], prelude[at + 1], prelude[at + 2], prelude[at + 3]]);
        let (version, length, crc) = (word(8), word(12), word(16));
        self.header_end = PRELUDE_BYTES as u64 + u64::from(length);
        let wrong = |problem| self.frame("header", problem);
        if length > HEADER_LIMIT_BYTES || u64::from(length) > self.file_bytes - PRELUDE_BYTES as u64 {
            return Err(wrong(format!("a length of {length} bytes in a file of {}", self.file_bytes)));
        }
        let mut body = self.read(PRELUDE_BYTES as u64, length as usize)?;
        if crc32fast::hash(&body) != crc {
            return Err(wrong("it is corrupt (CRC)".into()));
        }
        if version == OLD_VERSION {
            // The only field that it lacks is the last one.
            body.extend_from_slice(&0.0f64.to_le_bytes());
        }
        let mut header: Header = codec::decode::<_, { HEADER_LIMIT_BYTES as usize + size_of::<f64>() }>(&body)
            .map_err(|error| wrong(error.to_string()))?;
        if version == OLD_VERSION {
            header.bottom_um = header.bounds_bottom_um();
        }
        format::check_header(&header).map_err(wrong)?;
        Ok((version, header))
    }

    fn index(&mut self, header: &Header) -> Result<(Vec<ChunkEntry>, u64), BuildFileError> {
        let mut tail = [0; Footer::BYTES];
        let footer_offset = self.file_bytes.checked_sub(Footer::BYTES as u64);
        let footer_offset = footer_offset.ok_or_else(|| self.frame("footer", "the file is cut short".into()))?;
        tail.copy_from_slice(&self.read(footer_offset, Footer::BYTES)?);
        let footer = Footer::from_bytes(&tail).map_err(|problem| self.frame("footer", problem))?;

        let index_bytes = u64::from(footer.chunk_count) * ChunkEntry::BYTES as u64;
        let profile_offset = footer.index_offset.checked_add(index_bytes);
        let end = profile_offset.and_then(|offset| offset.checked_add(u64::from(footer.profile_bytes)));
        let (Some(profile_offset), true) = (profile_offset, end == Some(footer_offset)) else {
            let problem = format!(
                "{} chunks indexed from byte {} and a profile of {} bytes do not end at the footer, byte {footer_offset}",
                footer.chunk_count, footer.index_offset, footer.profile_bytes
            );
            return Err(self.frame("footer", problem));
        };
        let chunks = self.chunks(&footer, header)?;
        let peak_active = self.peak_active(&footer, profile_offset, header)?;
        Ok((chunks, peak_active))
    }

    fn chunks(&mut self, footer: &Footer, header: &Header) -> Result<Vec<ChunkEntry>, BuildFileError> {
        let bytes = self.read(footer.index_offset, footer.chunk_count as usize * ChunkEntry::BYTES)?;
        if crc32fast::hash(&bytes) != footer.index_crc {
            return Err(self.frame("index", "it is corrupt (CRC)".into()));
        }
        let mut chunks: Vec<ChunkEntry> = Vec::with_capacity(footer.chunk_count as usize);
        let mut check = IndexCheck { end: self.header_end, z_low: i32::MIN, struts: 0, balls: 0 };
        for (number, bytes) in bytes.chunks_exact(ChunkEntry::BYTES).enumerate() {
            let entry = codec::decode::<_, { ChunkEntry::BYTES }>(bytes)
                .map_err(|error| error.to_string())
                .and_then(|entry| check.entry(entry, header))
                .map_err(|problem| self.frame("index", format!("chunk {number}: {problem}")))?;
            chunks.push(entry);
        }
        check.finish(footer.index_offset, header).map_err(|problem| self.frame("index", problem))?;
        Ok(chunks)
    }

    fn peak_active(&self, footer: &Footer, offset: u64, header: &Header) -> Result<u64, BuildFileError> {
        let wrong = |problem| self.frame("profile", problem);
        // 64 KiB of counts never grow when packed but for a few bytes of frame.
        if footer.profile_bytes as usize > 2 * profile::LIMIT_BYTES {
            return Err(wrong(format!("{} bytes are too many", footer.profile_bytes)));
        }
        let packed = self.read(offset, footer.profile_bytes as usize)?;
        if crc32fast::hash(&packed) != footer.profile_crc {
            return Err(wrong("it is corrupt (CRC)".into()));
        }
        let bytes = zstd::bulk::decompress(&packed, profile::LIMIT_BYTES)
            .map_err(|error| wrong(format!("it does not decompress: {error}")))?;
        profile::peak_active(&bytes, header.strut_count + header.ball_count).map_err(wrong)
    }

    /// Reads `length` bytes, which the caller has checked to lie within the file.
    fn read(&self, offset: u64, length: usize) -> Result<Vec<u8>, BuildFileError> {
        let mut bytes = vec![0; length];
        let read = self.file.read_exact_at(&mut bytes, offset);
        read.map_err(|source| BuildFileError::Read { path: self.path.into(), source })?;
        Ok(bytes)
    }

    fn frame(&self, part: &'static str, problem: String) -> BuildFileError {
        BuildFileError::Frame { path: self.path.into(), part, problem }
    }
}

/// Running check of the index: chunks lie one behind another, in order, and count what the header says.
struct IndexCheck {
    end: u64,
    z_low: i32,
    struts: u64,
    balls: u64,
}

impl IndexCheck {
    fn entry(&mut self, entry: ChunkEntry, header: &Header) -> Result<ChunkEntry, String> {
        if entry.offset != self.end {
            return Err(format!("it lies at byte {}, but what is before it ends at {}", entry.offset, self.end));
        }
        self.end = entry.offset.checked_add(u64::from(entry.packed_bytes)).ok_or("its end overflows")?;
        if entry.strut_count == 0 || entry.strut_count as usize > CHUNK_STRUTS || entry.ball_count > entry.strut_count {
            return Err(format!(
                "{} struts, {} of them balls; allowed are 1 to {CHUNK_STRUTS}",
                entry.strut_count, entry.ball_count
            ));
        }
        if entry.packed_bytes > 2 * UNPACKED_LIMIT_BYTES || entry.unpacked_bytes > UNPACKED_LIMIT_BYTES {
            return Err(format!(
                "{} bytes, {} unpacked: a chunk has at most {UNPACKED_LIMIT_BYTES} unpacked, and twice as many packed",
                entry.packed_bytes, entry.unpacked_bytes
            ));
        }
        let ChunkEntry { z_low_min, z_low_max, z_high_max, .. } = entry;
        let least = self.z_low.max(header.bounds.min[2]);
        if z_low_min < least || z_low_max < z_low_min || z_high_max < z_low_max || z_high_max > header.bounds.max[2] {
            return Err(format!(
                "z from {z_low_min}..{z_low_max} to {z_high_max} quanta is out of order or out of the header's bounds"
            ));
        }
        self.z_low = z_low_max;
        self.struts += u64::from(entry.strut_count - entry.ball_count);
        self.balls += u64::from(entry.ball_count);
        Ok(entry)
    }

    fn finish(&self, index_offset: u64, header: &Header) -> Result<(), String> {
        if self.end != index_offset {
            return Err(format!("the last chunk ends at byte {}, but the index begins at {index_offset}", self.end));
        }
        if (self.struts, self.balls) != (header.strut_count, header.ball_count) {
            return Err(format!(
                "it counts {} struts and {} balls, but the header says {} and {}",
                self.struts, self.balls, header.strut_count, header.ball_count
            ));
        }
        Ok(())
    }
}
