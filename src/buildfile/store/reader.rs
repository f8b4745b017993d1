//! Reading: [`BuildFile::open`] checks the frame, [`BuildFile::read_chunk`] each chunk. Nothing is taken on the file's word.

use std::cell::RefCell;
use std::fs::{File, OpenOptions};
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::chunk;
use super::error::BuildFileError;
use super::index::ChunkEntry;
use super::lowest::LowestOfUnion;
use super::opening::{Opening, Stored};
use super::profile::ProfileBuilder;
use crate::buildfile::model::{Blend, BodyHeader, Bounds, Header, Lattice, Strut};
use crate::disk;

/// An open build file. Reading is thread-safe: every read states its place.
#[derive(Debug)]
pub struct BuildFile {
    path: PathBuf,
    file: File,
    file_bytes: u64,
    header: Header,
    chunks: Vec<ChunkEntry>,
    bodies: Vec<Stored>,
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
        // Also before it is opened: here another kind of file is no failure to read.
        let metadata = std::fs::metadata(path).map_err(read_error)?;
        if !metadata.is_file() {
            return Err(BuildFileError::Foreign { path: path.into(), problem: "it is not a regular file".into() });
        }
        Self::of(path, disk::open_regular(path, OpenOptions::new().read(true)).map_err(read_error)?)
    }

    /// The same of an open file, which `path` names in errors.
    pub(super) fn of(path: &Path, file: File) -> Result<Self, BuildFileError> {
        let metadata = file.metadata().map_err(|source| BuildFileError::Read { path: path.into(), source })?;
        let mut opening = Opening::new(path, &file, metadata.len());
        let header = opening.header()?;
        let (chunks, bodies) = opening.index(&header)?;
        Ok(Self { path: path.into(), file, file_bytes: metadata.len(), header, chunks, bodies })
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

    /// The chunks, body by body, those of a body in ascending order of their lowest node z.
    pub fn chunks(&self) -> &[ChunkEntry] {
        &self.chunks
    }

    /// Which chunks belong to a body.
    ///
    /// # Panics
    /// Where `body` is not below the number of the header's bodies.
    pub fn body_chunks(&self, body: usize) -> Range<usize> {
        self.bodies[body].chunks.clone()
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
        let BodyHeader::Lattice(lattice) = &self.header.bodies[usize::from(entry.body)];
        SCRATCH.with_borrow_mut(|scratch| {
            let ReadScratch { packed, unpacked, columns, decompressor } = scratch;
            packed.clear();
            packed.reserve_exact(entry.packed_bytes as usize);
            packed.resize(entry.packed_bytes as usize, 0);
            self.file
                .read_exact_at(packed, entry.offset)
                .map_err(|source| BuildFileError::Read { path: self.path.clone(), source })?;
            unpack(packed, entry, decompressor, unpacked)
                .and_then(|()| chunk::decode(unpacked, lattice, entry, columns, out))
                .map_err(|problem| BuildFileError::Chunk {
                    path: self.path.clone(),
                    chunk: index,
                    chunk_count: self.chunks.len(),
                    problem,
                })
        })
    }

    /// Reads every chunk once and compares header and profile with the struts, so that damage in the middle of a file is found before
    /// the first layer. Takes about as long as reading the file.
    ///
    /// # Errors
    /// [`BuildFileError`] names the first damaged chunk, or what the struts contradict.
    pub fn verify(&self) -> Result<(), BuildFileError> {
        let mut lowest = LowestOfUnion::default();
        for (lattice, stored) in self.header.lattices().zip(&self.bodies) {
            self.verify_lattice(lattice, stored, &mut lowest)?;
        }
        let (stated_um, lowest_um) = (self.header.bottom_um, lowest.um(self.header.quantum_um));
        if self.header.lattices().all(|lattice| lattice.blend == Blend::Union) && stated_um != lowest_um {
            return Err(self.contradiction(
                "header",
                format!("it says that the lowest solid point lies at {stated_um} µm, but it lies at {lowest_um} µm"),
            ));
        }
        Ok(())
    }

    fn verify_lattice(
        &self,
        lattice: &Lattice,
        stored: &Stored,
        lowest: &mut LowestOfUnion,
    ) -> Result<(), BuildFileError> {
        let Lattice { bounds, radius_range, .. } = lattice;
        let reach = lattice.reach_quanta(self.header.quantum_um);
        let (mut found, mut radii, mut profile) = (Bounds::EMPTY, [u32::MAX, 0], ProfileBuilder::default());
        let mut struts = Vec::new();
        for index in stored.chunks.clone() {
            struts.clear();
            self.read_chunk(index, &mut struts)?;
            for strut in &struts {
                let beyond = || self.contradiction("header", format!("{strut:?} reaches beyond ±2³¹ quanta"));
                found = found.with(strut).ok_or_else(beyond)?;
                let [least, most] = [strut.radius_a.min(strut.radius_b), strut.radius_a.max(strut.radius_b)];
                radii = [radii[0].min(least), radii[1].max(most)];
                profile.add(i64::from(strut.a[2]) - reach, i64::from(strut.b[2]) + reach);
                lowest.add(strut);
            }
        }
        if (&found, &radii) != (bounds, radius_range) {
            return Err(self.contradiction(
                "header",
                format!("it says {bounds:?} and radii {radius_range:?}, but the struts have {found:?} and {radii:?}"),
            ));
        }
        let (promised, peak) = (stored.peak_active, profile.peak_active());
        if peak > promised {
            return Err(self.contradiction(
                "profile",
                format!("it promises {promised} active struts at most, but there are {peak}"),
            ));
        }
        Ok(())
    }

    fn contradiction(&self, part: &'static str, problem: String) -> BuildFileError {
        BuildFileError::Frame { path: self.path.clone(), part, problem }
    }

    /// Most struts of a body active at any one z: those with `z_low − reach ≤ z ≤ z_high + reach`. An upper bound, exact but
    /// for struts that begin and end in the same of at most 4096 slabs of the body's height.
    ///
    /// # Panics
    /// Where `body` is not below the number of the header's bodies.
    pub fn body_peak_active(&self, body: usize) -> u64 {
        self.bodies[body].peak_active
    }

    /// Most struts of all bodies active at any one z: at most the sum of their peaks.
    pub fn peak_active(&self) -> u64 {
        self.bodies.iter().map(|stored| stored.peak_active).sum()
    }

    /// Bytes this value holds for as long as it is open.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>()
            + self.path.capacity()
            + self.header.source_name.capacity()
            + self.header.bodies.capacity() * size_of::<BodyHeader>()
            + self.bodies.capacity() * size_of::<Stored>()
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
