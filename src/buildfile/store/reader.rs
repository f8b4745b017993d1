//! Reading: [`BuildFile::open`] checks the frame, [`BuildFile::read_chunk`] each chunk. No statement of the file is trusted before it is
//! checked. [`buildfile`](crate::buildfile) has an example.

use std::cell::RefCell;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::chunk::{ChunkError, ChunkReader};
use super::error::BuildFileError;
use super::format::MAX_HEADER_BYTES;
use super::index::ChunkEntry;
use super::maps;
use super::opening::{Opening, Stored};
use crate::buildfile::model::{BodyHeader, Clip, Header, Strut, Triangle};
use crate::buildfile::primitive::Primitive;
use crate::buildfile::relief::{MapHeader, Patch};
use crate::disk::{self, File, How};
use crate::solid::HeightMap;
use crate::system::FileKind;

/// Bytes of a height map that are read at a time.
const PIECE_BYTES: usize = 64 << 10;

/// An open build file. Several threads may read at once: every read states its offset.
#[derive(Debug)]
pub struct BuildFile {
    path: PathBuf,
    file: File,
    file_bytes: u64,
    header: Header,
    /// Offset of the first height map.
    maps_offset: u64,
    chunks: Vec<ChunkEntry>,
    bodies: Vec<Stored>,
}

thread_local! {
    static READER: RefCell<ChunkReader> = RefCell::default();
}

impl BuildFile {
    /// Opens a build file and checks its header, index and profile. Chunks are checked when they are read.
    ///
    /// # Errors
    /// [`BuildFileError`] says what is wrong, and where.
    pub fn open(path: &Path) -> Result<Self, BuildFileError> {
        let read_error = |source| BuildFileError::Read { path: path.into(), source };
        // Before opening, so that a directory or a pipe gets a better message than a failure to read.
        let metadata = disk::metadata(path).map_err(read_error)?;
        if metadata.kind != FileKind::File {
            return Err(BuildFileError::Foreign { path: path.into(), problem: "it is not a regular file".into() });
        }
        Self::of(path, File::open(path, How::Read).map_err(read_error)?)
    }

    /// As [`BuildFile::open`], of an open file. `path` names it in errors.
    pub(super) fn of(path: &Path, file: File) -> Result<Self, BuildFileError> {
        let metadata = file.metadata().map_err(|source| BuildFileError::Read { path: path.into(), source })?;
        let mut opening = Opening::new(path, &file, metadata.length_bytes);
        let header = opening.header()?;
        let (chunks, bodies) = opening.index(&header)?;
        let maps_offset = opening.header_end();
        Ok(Self { path: path.into(), file, file_bytes: metadata.length_bytes, header, maps_offset, chunks, bodies })
    }

    /// The path that was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file, bytes.
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// The header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The chunks, body by body. Those of one body are in ascending order of their lowest z.
    pub fn chunks(&self) -> &[ChunkEntry] {
        &self.chunks
    }

    /// The chunks of a body, as indices of [`BuildFile::chunks`].
    ///
    /// # Panics
    /// If `body` is not below the number of bodies.
    pub fn body_chunks(&self, body: usize) -> Range<usize> {
        self.bodies[body].chunks.clone()
    }

    /// Reads chunk `index` and appends its struts to `out`, in ascending order of their lower nodes.
    ///
    /// # Errors
    /// [`BuildFileError`] if the chunk cannot be read, is damaged, or holds no struts. Then `out` is as before.
    ///
    /// # Panics
    /// If `index` is not below `chunks().len()`.
    pub fn read_chunk(&self, index: usize, out: &mut Vec<Strut>) -> Result<(), BuildFileError> {
        match &self.header.bodies[usize::from(self.chunks[index].body)] {
            BodyHeader::Lattice(lattice) => self.read_primitives(index, lattice, out),
            _ => Err(self.wrong_chunk(index, "it holds no struts".into())),
        }
    }

    /// As [`BuildFile::read_chunk`], of a surface or a clip: its triangles, in ascending order of their lowest corners.
    ///
    /// # Errors
    /// [`BuildFileError`] if the chunk cannot be read, is damaged, or holds no triangles. Then `out` is as before.
    ///
    /// # Panics
    /// If `index` is not below `chunks().len()`.
    pub fn read_triangles(&self, index: usize, out: &mut Vec<Triangle>) -> Result<(), BuildFileError> {
        match &self.header.bodies[usize::from(self.chunks[index].body)] {
            BodyHeader::Surface(surface) | BodyHeader::Clip(Clip { surface, .. }) => {
                self.read_primitives(index, surface, out)
            }
            _ => Err(self.wrong_chunk(index, "it holds no triangles".into())),
        }
    }

    /// As [`BuildFile::read_chunk`], of a relief: its patches, in ascending order of their lowest z.
    ///
    /// # Errors
    /// [`BuildFileError`] if the chunk cannot be read, is damaged, or holds no patches. Then `out` is as before.
    ///
    /// # Panics
    /// If `index` is not below `chunks().len()`.
    pub fn read_patches(&self, index: usize, out: &mut Vec<Patch>) -> Result<(), BuildFileError> {
        match &self.header.bodies[usize::from(self.chunks[index].body)] {
            BodyHeader::Relief(relief) => self.read_primitives(index, relief, out),
            _ => Err(self.wrong_chunk(index, "it holds no patches".into())),
        }
    }

    /// Reads the height maps of a body, each halved as often as `level` says.
    ///
    /// # Errors
    /// [`BuildFileError`] if a map cannot be read or is damaged.
    ///
    /// # Panics
    /// If `body` is not below the number of bodies.
    pub(crate) fn read_maps(
        &self,
        body: usize,
        level: impl Fn(&MapHeader) -> u8,
    ) -> Result<Vec<Arc<HeightMap>>, BuildFileError> {
        let maps = self.header.bodies[body].maps().iter().enumerate();
        maps.map(|(number, header)| Ok(Arc::new(self.read_map(body, number, level(header))?))).collect()
    }

    /// A height map of a body, halved `level` times.
    pub(super) fn read_map(&self, body: usize, number: usize, level: u8) -> Result<HeightMap, BuildFileError> {
        let wrong = |problem| self.contradiction("height map", format!("number {number}: {problem}"));
        maps::decode(&self.map_bytes(body, number)?, &self.header.bodies[body].maps()[number], level).map_err(wrong)
    }

    /// The PNG of a height map.
    fn map_bytes(&self, body: usize, number: usize) -> Result<Vec<u8>, BuildFileError> {
        // Opening has compared the lengths of the maps with that of the file.
        let mut bytes = Vec::with_capacity(self.header.bodies[body].maps()[number].bytes as usize);
        self.read_map_bytes(body, number, |piece| bytes.extend_from_slice(piece))?;
        Ok(bytes)
    }

    /// Reads the PNG of a height map piece by piece, and checks its CRC.
    pub(super) fn read_map_bytes(
        &self,
        body: usize,
        number: usize,
        mut take: impl FnMut(&[u8]),
    ) -> Result<(), BuildFileError> {
        let bodies = &self.header.bodies;
        let before = bodies[..body].iter().flat_map(BodyHeader::maps).chain(&bodies[body].maps()[..number]);
        let mut offset = self.maps_offset + before.map(|map| u64::from(map.bytes)).sum::<u64>();
        let header = bodies[body].maps()[number];
        let end = offset + u64::from(header.bytes);
        let mut crc = crc32fast::Hasher::new();
        let mut room = vec![0; PIECE_BYTES];
        while offset < end {
            let piece = &mut room[..PIECE_BYTES.min((end - offset) as usize)];
            let read = self.file.read_exact_at(piece, offset);
            read.map_err(|source| BuildFileError::Read { path: self.path.clone(), source })?;
            crc.update(piece);
            take(piece);
            offset += piece.len() as u64;
        }
        if crc.finalize() != header.crc {
            return Err(self.contradiction("height map", format!("number {number} is corrupt (CRC)")));
        }
        Ok(())
    }

    fn read_primitives<P: Primitive>(
        &self,
        index: usize,
        body: &P::Body,
        out: &mut Vec<P>,
    ) -> Result<(), BuildFileError> {
        let read = READER.with_borrow_mut(|reader| reader.read(&self.file, &self.chunks[index], body, out));
        read.map_err(|error| match error {
            ChunkError::Read(source) => BuildFileError::Read { path: self.path.clone(), source },
            ChunkError::Damaged(problem) => self.wrong_chunk(index, problem),
        })
    }

    pub(super) fn wrong_chunk(&self, chunk: usize, problem: String) -> BuildFileError {
        BuildFileError::Chunk { path: self.path.clone(), chunk, chunk_count: self.chunks.len(), problem }
    }

    pub(super) fn contradiction(&self, part: &'static str, problem: String) -> BuildFileError {
        BuildFileError::Frame { path: self.path.clone(), part, problem }
    }

    /// Upper bound of the number of primitives of a body that are active at any z: those with `z_low − reach ≤ z ≤ z_high + reach`, where
    /// triangles have no reach. It is exact for each of the up to 4096 slabs of the body, in which all primitives that are active anywhere in
    /// the slab count.
    ///
    /// # Panics
    /// If `body` is not below the number of bodies.
    pub fn body_peak_active(&self, body: usize) -> u64 {
        self.bodies[body].peak_active
    }

    /// Upper bound of the number of primitives of all bodies that are active at any z: the sum of their peaks.
    pub fn peak_active(&self) -> u64 {
        self.bodies.iter().map(|stored| stored.peak_active).sum()
    }

    /// Memory of this value while the file is open, bytes.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>()
            + self.path.capacity()
            + self.header.source_name.capacity()
            + self.header.bodies.capacity() * size_of::<BodyHeader>()
            // What a relief lists is decoded from the header.
            + 2 * MAX_HEADER_BYTES as usize
            + self.bodies.capacity() * size_of::<Stored>()
            + self.chunks.capacity() * size_of::<ChunkEntry>()
    }

    /// Memory of each thread that reads chunks, bytes, at most: a packed and an unpacked chunk, node table and columns, and the state of
    /// the decompressor.
    pub fn scratch_bytes(&self) -> usize {
        let primitive_bytes = self.header.bodies.iter().map(|body| match body {
            BodyHeader::Lattice(_) => Strut::SCRATCH_BYTES,
            BodyHeader::Surface(_) | BodyHeader::Clip(_) => Triangle::SCRATCH_BYTES,
            BodyHeader::Relief(_) => Patch::SCRATCH_BYTES,
        });
        ChunkReader::memory_bytes(&self.chunks, primitive_bytes.max().unwrap_or(0))
    }
}
