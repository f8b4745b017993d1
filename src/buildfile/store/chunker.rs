//! Chunks on their way into a file: primitives are collected, compressed on other threads, and written in order. `writer` uses it.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::num::NonZero;

use super::encoders::{Encoded, Encoders};
use super::format::Footer;
use super::index::ChunkEntry;
use crate::buildfile::primitive::Primitive;
use crate::codec;

/// Buffer of the file, bytes: several chunks for each write.
const FILE_BUFFER_BYTES: usize = 256 << 10;

/// Compression level of the profile. There is one in a file, so its time does not matter.
const PROFILE_LEVEL: i32 = 9;

/// A file to which chunks are appended, and its index.
pub(super) struct ChunkFile {
    file: BufWriter<File>,
    offset: u64,
    /// The body of the chunks that are appended.
    body: u16,
    index: Vec<ChunkEntry>,
}

impl ChunkFile {
    /// Begins `file` with `front`, for which [`ChunkFile::complete`] later substitutes bytes of the same length.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn begin(file: File, front: &[u8]) -> io::Result<Self> {
        let mut file = BufWriter::with_capacity(FILE_BUFFER_BYTES, file);
        file.write_all(front)?;
        Ok(Self { file, offset: front.len() as u64, body: 0, index: Vec::new() })
    }

    /// Writes a height map. All maps come before the first chunk.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(super) fn map(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)?;
        self.offset += bytes.len() as u64;
        Ok(())
    }

    /// The chunks that follow belong to the next body.
    pub(super) fn next_body(&mut self) {
        self.body += 1;
    }

    fn append(&mut self, packed: &[u8], entry: ChunkEntry) -> io::Result<()> {
        self.file.write_all(packed)?;
        self.index.push(ChunkEntry { offset: self.offset, body: self.body, ..entry });
        self.offset += packed.len() as u64;
        Ok(())
    }

    /// Writes index, profiles and footer, then `front` over the first bytes.
    ///
    /// # Errors
    /// If they cannot be written.
    pub(super) fn complete(mut self, front: &[u8], profiles: &[u8]) -> io::Result<()> {
        let mut index_crc = crc32fast::Hasher::new();
        for entry in &self.index {
            let bytes = codec::encode(entry).map_err(io::Error::other)?;
            index_crc.update(&bytes);
            self.file.write_all(&bytes)?;
        }
        let profile = zstd::bulk::compress(profiles, PROFILE_LEVEL)?;
        self.file.write_all(&profile)?;
        let footer = Footer {
            index_offset: self.offset,
            chunk_count: u32::try_from(self.index.len()).map_err(io::Error::other)?,
            index_crc: index_crc.finalize(),
            profile_bytes: profile.len() as u32,
            profile_crc: crc32fast::hash(&profile),
        };
        self.file.write_all(&footer.to_bytes())?;
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(front)?;
        self.file.flush()
    }
}

/// Divides primitives into chunks.
pub(super) struct Chunker<P> {
    encoders: Encoders<P>,
    pending: Vec<P>,
}

impl<P: Primitive> Chunker<P> {
    /// A chunker with so many threads that compress. The file does not depend on their number.
    ///
    /// # Errors
    /// If a thread cannot be started.
    pub(super) fn new(threads: NonZero<usize>) -> io::Result<Self> {
        Ok(Self { encoders: Encoders::new(threads)?, pending: Vec::with_capacity(P::CHUNK_PRIMITIVES) })
    }

    /// Adds a primitive, and sends the chunk that it completes to be compressed.
    ///
    /// # Errors
    /// If an earlier chunk could not be compressed or written.
    pub(super) fn push(&mut self, primitive: P, file: &mut ChunkFile) -> io::Result<()> {
        self.pending.push(primitive);
        if self.pending.len() == P::CHUNK_PRIMITIVES { self.send(file) } else { Ok(()) }
    }

    /// Writes everything that was added, so that the next chunk may belong to another body.
    ///
    /// # Errors
    /// If a chunk cannot be compressed or written.
    pub(super) fn finish_body(&mut self, file: &mut ChunkFile) -> io::Result<()> {
        if !self.pending.is_empty() {
            self.send(file)?;
        }
        while self.write_oldest(file)?.is_some() {}
        Ok(())
    }

    fn send(&mut self, file: &mut ChunkFile) -> io::Result<()> {
        let empty = if self.encoders.is_full() { self.write_oldest(file)? } else { None };
        let empty = empty.unwrap_or_else(|| Vec::with_capacity(P::CHUNK_PRIMITIVES));
        self.encoders.send(std::mem::replace(&mut self.pending, empty))
    }

    /// Writes the oldest chunk that was sent, and returns its emptied buffer; `None` if all are written.
    fn write_oldest(&mut self, file: &mut ChunkFile) -> io::Result<Option<Vec<P>>> {
        let Some(Encoded { entry, packed, mut primitives }) = self.encoders.receive()? else { return Ok(None) };
        file.append(&packed, entry)?;
        primitives.clear();
        Ok(Some(primitives))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::buildfile::model::Triangle;
    use crate::buildfile::primitive::Sortable;
    use crate::buildfile::primitive::triangle::triangles;
    use crate::buildfile::store::chunk::{ChunkError, ChunkReader};

    #[test]
    fn a_second_kind_of_primitive_is_written_and_read_in_chunks() {
        let file = tempfile::tempfile().expect("temporary file");
        let (surface, mut sorted) = triangles(5000, 11);
        sorted.sort_by_key(Sortable::key);
        let mut chunks = ChunkFile::begin(file.try_clone().expect("is open"), b"front").expect("can be written");
        let mut chunker = Chunker::<Triangle>::new(NonZero::<usize>::MIN.saturating_add(1)).expect("threads start");
        for triangle in &sorted {
            chunker.push(*triangle, &mut chunks).expect("can be written");
        }
        chunker.finish_body(&mut chunks).expect("can be written");
        let index = chunks.index.clone();
        chunks.complete(b"FRONT", &[]).expect("can be written");
        assert_eq!(index.iter().map(|entry| entry.count).collect::<Vec<_>>(), [2048, 2048, 904]);
        let z = |triangle: &Triangle| triangle.z_range();
        assert_eq!([index[1].z_low_min, index[1].z_low_max], [z(&sorted[2048])[0], z(&sorted[4095])[0]]);
        assert_eq!(Some(index[2].z_high_max), sorted[4096..].iter().map(|triangle| z(triangle)[1]).max());

        let file = crate::disk::File::from(file);
        let (mut reader, mut read) = (ChunkReader::default(), Vec::<Triangle>::new());
        for entry in &index {
            reader.read(&file, entry, &surface, &mut read).expect("is whole");
        }
        assert_eq!(read, sorted);
        let mut higher = surface.clone();
        higher.bounds.min[2] += 1;
        let refused = reader.read(&file, &index[0], &higher, &mut read).expect_err("its body begins higher");
        assert!(matches!(refused, ChunkError::Damaged(text) if text.contains("leaves the header's bounds")));
        let other = ChunkEntry { z_high_max: index[0].z_high_max + 1, ..index[0] };
        assert!(reader.read(&file, &other, &surface, &mut read).is_err(), "the entry is not that of the chunk");
        assert_eq!(read.len(), sorted.len(), "a refused chunk adds nothing");
    }
}
