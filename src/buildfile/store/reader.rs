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
use super::lowest::Lowest;
use super::maps;
use super::opening::{Opening, Stored};
use super::profile::ProfileBuilder;
use super::relief::ReliefBuilder;
use super::settings::{ReliefMap, ReliefSettings};
use crate::buildfile::model::{BodyHeader, Bounds, Clip, Header, Lattice, Strut, Surface, Triangle};
use crate::buildfile::primitive::{Primitive, Sortable};
use crate::buildfile::relief::{MapHeader, Patch, Relief};
use crate::disk::{self, File, How};
use crate::solid::HeightMap;
use crate::system::FileKind;

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
        let decoded = |(number, header): (usize, &MapHeader)| {
            let wrong = |problem| self.contradiction("height map", format!("number {number}: {problem}"));
            let map = maps::decode(&self.map_bytes(body, number)?, header, level(header)).map_err(wrong)?;
            Ok(Arc::new(map))
        };
        self.header.bodies[body].maps().iter().enumerate().map(decoded).collect()
    }

    /// The PNG of a height map.
    fn map_bytes(&self, body: usize, number: usize) -> Result<Vec<u8>, BuildFileError> {
        let bodies = &self.header.bodies;
        let before = bodies[..body].iter().flat_map(BodyHeader::maps).chain(&bodies[body].maps()[..number]);
        let offset = self.maps_offset + before.map(|map| u64::from(map.bytes)).sum::<u64>();
        let header = bodies[body].maps()[number];
        // Opening has compared the lengths of the maps with that of the file.
        let mut bytes = vec![0; header.bytes as usize];
        let read = self.file.read_exact_at(&mut bytes, offset);
        read.map_err(|source| BuildFileError::Read { path: self.path.clone(), source })?;
        if crc32fast::hash(&bytes) != header.crc {
            return Err(self.contradiction("height map", format!("number {number} is corrupt (CRC)")));
        }
        Ok(bytes)
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

    fn wrong_chunk(&self, chunk: usize, problem: String) -> BuildFileError {
        BuildFileError::Chunk { path: self.path.clone(), chunk, chunk_count: self.chunks.len(), problem }
    }

    /// Reads every chunk once and compares header and profile with the primitives, so that damage in the middle of a file is found before the
    /// first layer. Takes about as long as reading the file.
    ///
    /// # Errors
    /// [`BuildFileError`] names the first damaged chunk, or the statement that the primitives contradict.
    pub fn verify(&self) -> Result<(), BuildFileError> {
        let mut lowest = Lowest::default();
        for (body, (header, stored)) in self.header.bodies.iter().zip(&self.bodies).enumerate() {
            match header {
                BodyHeader::Lattice(lattice) => self.verify_lattice(lattice, stored, &mut lowest)?,
                BodyHeader::Surface(surface) | BodyHeader::Clip(Clip { surface, .. }) => {
                    self.verify_surface(surface, stored, &mut lowest)?;
                }
                BodyHeader::Relief(relief) => self.verify_relief(body, relief, &mut lowest)?,
            }
        }
        let (stated_um, lowest_um) = (self.header.bottom_um, lowest.um(self.header.quantum_um));
        if self.header.bodies.iter().all(BodyHeader::is_exact) && stated_um != lowest_um {
            return Err(self.contradiction(
                "header",
                format!("it says that the lowest solid point lies at {stated_um} µm, but it lies at {lowest_um} µm"),
            ));
        }
        Ok(())
    }

    fn verify_lattice(&self, lattice: &Lattice, stored: &Stored, lowest: &mut Lowest) -> Result<(), BuildFileError> {
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
        self.verify_peak(stored, &profile)
    }

    fn verify_surface(&self, surface: &Surface, stored: &Stored, lowest: &mut Lowest) -> Result<(), BuildFileError> {
        let (mut found, mut profile) = (Bounds::EMPTY, ProfileBuilder::default());
        let (mut triangles, mut last) = (Vec::new(), None);
        for index in stored.chunks.clone() {
            triangles.clear();
            self.read_triangles(index, &mut triangles)?;
            for triangle in &triangles {
                if last.is_some_and(|last| last > triangle.key()) {
                    return Err(self.wrong_chunk(index, format!("{triangle:?} comes after a higher one")));
                }
                last = Some(triangle.key());
                found = found.joined(&triangle.bounds());
                let [low, high] = triangle.z_range().map(i64::from);
                profile.add(low, high);
                lowest.add_triangle(triangle);
            }
        }
        if found != surface.bounds {
            let problem = format!("it says {:?}, but the triangles have {found:?}", surface.bounds);
            return Err(self.contradiction("header", problem));
        }
        self.verify_peak(stored, &profile)
    }

    fn verify_relief(&self, body: usize, relief: &Relief, lowest: &mut Lowest) -> Result<(), BuildFileError> {
        let maps = relief
            .maps
            .iter()
            .enumerate()
            .map(|(number, map)| Ok(ReliefMap { header: *map, png: self.map_bytes(body, number)?.into() }));
        let settings = ReliefSettings {
            is_curved: relief.is_curved,
            shell_um: relief.shell_um,
            displacements: relief.displacements.clone(),
            maps: maps.collect::<Result<_, BuildFileError>>()?,
        };
        let wrong = |problem| self.contradiction("height map", problem);
        let mut found = ReliefBuilder::new(&settings, self.header.quantum_um).map_err(wrong)?;
        let (mut patches, stored) = (Vec::new(), &self.bodies[body]);
        for index in stored.chunks.clone() {
            patches.clear();
            self.read_patches(index, &mut patches)?;
            let added = patches.iter().try_for_each(|patch| found.add(*patch));
            added.map_err(|problem| self.wrong_chunk(index, problem))?;
        }
        found.finish();
        lowest.add_z(found.lowest());
        let header = found.header();
        if (&header.bounds, &header.z_reach) != (&relief.bounds, &relief.z_reach) {
            let problem = format!(
                "it says {:?} and z {:?}, but the patches have {:?} and {:?}",
                relief.bounds, relief.z_reach, header.bounds, header.z_reach
            );
            return Err(self.contradiction("header", problem));
        }
        self.verify_peak(stored, found.profile())
    }

    fn verify_peak(&self, stored: &Stored, profile: &ProfileBuilder) -> Result<(), BuildFileError> {
        let (stated, peak) = (stored.peak_active, profile.peak_active());
        if peak > stated {
            let problem = format!("it states at most {stated} active primitives, but there are {peak}");
            return Err(self.contradiction("profile", problem));
        }
        Ok(())
    }

    fn contradiction(&self, part: &'static str, problem: String) -> BuildFileError {
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
