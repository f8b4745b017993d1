//! Opens a build file: reads header, index and profile, and compares them with one another and with the length of the file.
//! `reader` uses it.

use std::ops::Range;
use std::path::Path;

use super::chunk::{MAX_CHUNK_PRIMITIVES, MAX_PACKED_BYTES, MAX_UNPACKED_BYTES};
use super::error::BuildFileError;
use super::format::{self, Footer, MAX_HEADER_BYTES, PRELUDE_BYTES, check_beginning};
use super::index::ChunkEntry;
use super::profile;
use crate::buildfile::model::{BodyHeader, Header};
use crate::codec;
use crate::disk::File;

/// What index and profile say about one body.
#[derive(Debug)]
pub(super) struct Stored {
    pub(super) chunks: Range<usize>,
    pub(super) peak_active: u64,
}

/// A build file whose frame is being read.
pub(super) struct Opening<'a> {
    path: &'a Path,
    file: &'a File,
    file_bytes: u64,
    /// Offset of the first chunk.
    header_end: u64,
}

impl<'a> Opening<'a> {
    pub(super) fn new(path: &'a Path, file: &'a File, file_bytes: u64) -> Self {
        Self { path, file, file_bytes, header_end: 0 }
    }

    /// The header.
    ///
    /// # Errors
    /// If prelude or header are not those of a build file.
    pub(super) fn header(&mut self) -> Result<Header, BuildFileError> {
        let foreign = |problem: String| BuildFileError::Foreign { path: self.path.into(), problem };
        if self.file_bytes < PRELUDE_BYTES as u64 {
            return Err(foreign(format!("{} bytes are too few for a build file (.layerd)", self.file_bytes)));
        }
        let prelude = self.read(0, PRELUDE_BYTES)?;
        check_beginning(&prelude).map_err(foreign)?;
        let word = |at: usize| u32::from_le_bytes([prelude[at], prelude[at + 1], prelude[at + 2], prelude[at + 3]]);
        let (length, crc) = (word(12), word(16));
        self.header_end = PRELUDE_BYTES as u64 + u64::from(length);
        let wrong = |problem| self.frame("header", problem);
        if length > MAX_HEADER_BYTES || u64::from(length) > self.file_bytes - PRELUDE_BYTES as u64 {
            return Err(wrong(format!("a length of {length} bytes in a file of {}", self.file_bytes)));
        }
        let body = self.read(PRELUDE_BYTES as u64, length as usize)?;
        if crc32fast::hash(&body) != crc {
            return Err(wrong("it is corrupt (CRC)".into()));
        }
        let header: Header =
            codec::decode::<_, { MAX_HEADER_BYTES as usize }>(&body).map_err(|error| wrong(error.to_string()))?;
        format::check_header(&header).map_err(wrong)?;
        Ok(header)
    }

    /// Offset of the first height map.
    pub(super) fn header_end(&self) -> u64 {
        self.header_end
    }

    /// Index and profile. Call [`Opening::header`] first.
    ///
    /// # Errors
    /// If they contradict themselves, the header or the length of the file.
    pub(super) fn index(&mut self, header: &Header) -> Result<(Vec<ChunkEntry>, Vec<Stored>), BuildFileError> {
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
        let peaks = self.peaks(&footer, profile_offset, header)?;
        // The check of the index made sure that the chunks of each body are together, in the order of the bodies.
        let begins = |body: usize| chunks.partition_point(|entry| usize::from(entry.body) < body);
        let stored = |(body, peak_active)| Stored { chunks: begins(body)..begins(body + 1), peak_active };
        let bodies = peaks.into_iter().enumerate().map(stored).collect();
        Ok((chunks, bodies))
    }

    fn chunks(&mut self, footer: &Footer, header: &Header) -> Result<Vec<ChunkEntry>, BuildFileError> {
        let bytes = self.read(footer.index_offset, footer.chunk_count as usize * ChunkEntry::BYTES)?;
        if crc32fast::hash(&bytes) != footer.index_crc {
            return Err(self.frame("index", "it is corrupt (CRC)".into()));
        }
        let mut chunks: Vec<ChunkEntry> = Vec::with_capacity(footer.chunk_count as usize);
        let maps_bytes: u64 = header.bodies.iter().flat_map(BodyHeader::maps).map(|map| u64::from(map.bytes)).sum();
        let mut check = IndexCheck::new(self.header_end + maps_bytes, header);
        for (number, bytes) in bytes.chunks_exact(ChunkEntry::BYTES).enumerate() {
            let entry = codec::decode::<_, { ChunkEntry::BYTES }>(bytes)
                .map_err(|error| error.to_string())
                .and_then(|entry| check.entry(entry))
                .map_err(|problem| self.frame("index", format!("chunk {number}: {problem}")))?;
            chunks.push(entry);
        }
        check.finish(footer.index_offset).map_err(|problem| self.frame("index", problem))?;
        Ok(chunks)
    }

    fn peaks(&self, footer: &Footer, offset: u64, header: &Header) -> Result<Vec<u64>, BuildFileError> {
        let wrong = |problem| self.frame("profile", problem);
        let limit_bytes = header.bodies.len() * profile::MAX_BYTES;
        // Compression adds at most a few bytes.
        if footer.profile_bytes as usize > 2 * limit_bytes {
            return Err(wrong(format!("{} bytes are too many", footer.profile_bytes)));
        }
        let packed = self.read(offset, footer.profile_bytes as usize)?;
        if crc32fast::hash(&packed) != footer.profile_crc {
            return Err(wrong("it is corrupt (CRC)".into()));
        }
        let bytes = zstd::bulk::decompress(&packed, limit_bytes)
            .map_err(|error| wrong(format!("it does not decompress: {error}")))?;
        let totals = header.bodies.iter().map(BodyHeader::total);
        profile::peaks(&bytes, totals).map_err(wrong)
    }

    /// Reads `length` bytes. The caller has checked that they lie within the file.
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

/// Checks the index entry by entry: chunks follow one another without gaps, body by body and in ascending z, and their counts add up to
/// those of the header.
struct IndexCheck<'a> {
    bodies: &'a [BodyHeader],
    /// End of the previous chunk.
    end: u64,
    /// The current body; `z_low`, `others` and `balls` belong to it.
    body: usize,
    z_low: i32,
    /// Primitives that are no balls.
    others: u64,
    balls: u64,
}

impl<'a> IndexCheck<'a> {
    fn new(end: u64, header: &'a Header) -> Self {
        Self { bodies: &header.bodies, end, body: 0, z_low: i32::MIN, others: 0, balls: 0 }
    }

    fn entry(&mut self, entry: ChunkEntry) -> Result<ChunkEntry, String> {
        if entry.offset != self.end {
            return Err(format!("it lies at byte {}, but what is before it ends at {}", entry.offset, self.end));
        }
        self.end = entry.offset.checked_add(u64::from(entry.packed_bytes)).ok_or("its end overflows")?;
        if usize::from(entry.body) == self.body + 1 && usize::from(entry.body) < self.bodies.len() {
            self.counts_agree()?;
            (self.body, self.z_low, self.others, self.balls) = (self.body + 1, i32::MIN, 0, 0);
        } else if usize::from(entry.body) != self.body {
            let bodies = self.bodies.len();
            return Err(format!("it belongs to body {} of {bodies}, but follows body {}", entry.body, self.body));
        }
        let (count, balls) = (entry.count, u32::from(entry.ball_count));
        if count == 0 || count as usize > MAX_CHUNK_PRIMITIVES || balls > count {
            return Err(format!("{count} primitives, {balls} of them balls; allowed are 1 to {MAX_CHUNK_PRIMITIVES}"));
        }
        if entry.packed_bytes > MAX_PACKED_BYTES || entry.unpacked_bytes > MAX_UNPACKED_BYTES {
            return Err(format!(
                "{} bytes, {} unpacked: a chunk has at most {MAX_UNPACKED_BYTES} unpacked, and twice as many packed",
                entry.packed_bytes, entry.unpacked_bytes
            ));
        }
        let ChunkEntry { z_low_min, z_low_max, z_high_max, .. } = entry;
        let [lowest, highest] = self.bodies[self.body].z_reach();
        let least = self.z_low.max(lowest);
        if z_low_min < least || z_low_max < z_low_min || z_high_max < z_low_max || z_high_max > highest {
            return Err(format!(
                "z from {z_low_min}..{z_low_max} to {z_high_max} quanta is out of order or out of the header's bounds"
            ));
        }
        self.z_low = z_low_max;
        self.others += u64::from(count - balls);
        self.balls += u64::from(balls);
        Ok(entry)
    }

    fn counts_agree(&self) -> Result<(), String> {
        let (others, balls) = (self.others, self.balls);
        match &self.bodies[self.body] {
            BodyHeader::Lattice(lattice) if (others, balls) != (lattice.strut_count, lattice.ball_count) => {
                Err(format!(
                    "it counts {others} struts and {balls} balls, but the header says {} and {}",
                    lattice.strut_count, lattice.ball_count
                ))
            }
            BodyHeader::Lattice(_) => Ok(()),
            body if (others, balls) != (body.total(), 0) => Err(format!(
                "it has {others} triangles or patches and {balls} balls; the header says {} and no balls",
                body.total()
            )),
            _ => Ok(()),
        }
    }

    fn finish(&self, index_offset: u64) -> Result<(), String> {
        if self.end != index_offset {
            return Err(format!("the last chunk ends at byte {}, but the index begins at {index_offset}", self.end));
        }
        self.counts_agree()?;
        if self.body + 1 < self.bodies.len() {
            return Err(format!("it has chunks of {} bodies, but the header has {}", self.body + 1, self.bodies.len()));
        }
        Ok(())
    }
}
