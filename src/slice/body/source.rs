//! Where the primitives of a body come from: chunks in ascending order, from a build file or from memory. `feed` reads them, for the
//! sweeps of all kinds of bodies. `lattice/sweep.rs` and `surface/sweep.rs` have a source each.

use std::fmt::Debug;
use std::sync::Arc;

use crate::buildfile::{
    BuildFile, BuildFileError, Lattice, MAX_CHUNK_PRIMITIVES, MapHeader, Patch, QUANTUM_FRACTIONS, Relief, Strut,
    Surface, Triangle,
};
use crate::solid::HeightMap;

/// What a body consists of: struts and balls, triangles, or patches.
pub trait BodyPrimitive: Copy + Debug + Send + Sync + 'static {
    /// The header of such a body.
    type Header: Clone + Debug + Send + Sync;

    /// The height by which primitives are in ascending order, in any unit.
    fn order(&self) -> i64;

    /// Lowest and highest z, quanta.
    fn z_range(&self) -> [i32; 2];

    /// Appends the primitives of a chunk of a build file to `out`.
    ///
    /// # Errors
    /// If the chunk cannot be read, is damaged, or holds other primitives.
    fn read(file: &BuildFile, chunk: usize, out: &mut Vec<Self>) -> Result<(), BuildFileError>;
}

impl BodyPrimitive for Strut {
    type Header = Lattice;

    fn order(&self) -> i64 {
        i64::from(self.a[2])
    }

    fn z_range(&self) -> [i32; 2] {
        [self.a[2], self.b[2]]
    }

    fn read(file: &BuildFile, chunk: usize, out: &mut Vec<Self>) -> Result<(), BuildFileError> {
        file.read_chunk(chunk, out)
    }
}

impl BodyPrimitive for Triangle {
    type Header = Surface;

    fn order(&self) -> i64 {
        self.corners[0][2]
    }

    fn z_range(&self) -> [i32; 2] {
        let [a, b, c] = self.corners.map(|corner| corner[2]);
        let quanta = |fractions: i64| fractions.div_euclid(QUANTUM_FRACTIONS) as i32;
        [quanta(a), -quanta(-b.max(c))]
    }

    fn read(file: &BuildFile, chunk: usize, out: &mut Vec<Self>) -> Result<(), BuildFileError> {
        file.read_triangles(chunk, out)
    }
}

impl BodyPrimitive for Patch {
    type Header = Relief;

    fn order(&self) -> i64 {
        i64::from(self.z[0])
    }

    fn z_range(&self) -> [i32; 2] {
        self.z
    }

    fn read(file: &BuildFile, chunk: usize, out: &mut Vec<Self>) -> Result<(), BuildFileError> {
        file.read_patches(chunk, out)
    }
}

/// Range of z of the primitives in a chunk, quanta.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkSpan {
    /// Lowest z of any primitive.
    pub lowest_z: i32,
    /// Highest z of any primitive.
    pub highest_z: i32,
}

/// A body that can be read chunk by chunk. Its primitives are in ascending order of [`BodyPrimitive::order`].
pub trait ChunkSource<P: BodyPrimitive>: Send + Sync {
    /// The header of the body.
    fn header(&self) -> &P::Header;

    /// Length of a quantum, micrometres.
    fn quantum_um(&self) -> f64;

    /// Number of chunks.
    fn chunk_count(&self) -> usize;

    /// Most primitives in any chunk.
    fn chunk_primitives(&self) -> usize;

    /// Range of z of a chunk. The lowest z ascends from chunk to chunk.
    fn chunk_span(&self, chunk: usize) -> ChunkSpan;

    /// Upper bound of the number of primitives within reach of any plane. It is known before a chunk is read.
    fn peak_active(&self) -> u64;

    /// The open build file that the source reads, if it reads one. Bodies of one file share its memory, so it is counted once.
    fn file(&self) -> Option<&Arc<BuildFile>> {
        None
    }

    /// Memory of the source itself, bytes, at most: without [`ChunkSource::file`] and the primitives it hands out.
    fn memory_bytes(&self) -> u64;

    /// Replaces the contents of `primitives` with those of a chunk.
    ///
    /// # Errors
    /// If the chunk cannot be read; names the file and the place in it.
    fn read_chunk(&self, chunk: usize, primitives: &mut Vec<P>) -> anyhow::Result<()>;

    /// Reads the height maps of a relief, each halved as often as `level` says.
    ///
    /// # Errors
    /// If a map cannot be read; names the file and the map. Also if the source has none.
    fn read_maps(&self, _level: &dyn Fn(&MapHeader) -> u8) -> anyhow::Result<Vec<Arc<HeightMap>>> {
        anyhow::bail!("this source has no height maps")
    }
}

/// One body of a build file.
pub(in crate::slice) struct Stored<P: BodyPrimitive> {
    pub(in crate::slice) file: Arc<BuildFile>,
    pub(in crate::slice) body: usize,
    /// The header, with the joint to be drawn if it is a lattice.
    pub(in crate::slice) header: P::Header,
}

impl<P: BodyPrimitive> ChunkSource<P> for Stored<P> {
    fn header(&self) -> &P::Header {
        &self.header
    }

    fn quantum_um(&self) -> f64 {
        self.file.header().quantum_um
    }

    fn chunk_count(&self) -> usize {
        self.file.body_chunks(self.body).len()
    }

    fn chunk_primitives(&self) -> usize {
        let chunks = &self.file.chunks()[self.file.body_chunks(self.body)];
        chunks.iter().map(|entry| entry.count as usize).max().unwrap_or(0)
    }

    fn chunk_span(&self, chunk: usize) -> ChunkSpan {
        let entry = &self.file.chunks()[self.file.body_chunks(self.body).start + chunk];
        ChunkSpan { lowest_z: entry.z_low_min, highest_z: entry.z_high_max }
    }

    fn peak_active(&self) -> u64 {
        self.file.body_peak_active(self.body)
    }

    fn file(&self) -> Option<&Arc<BuildFile>> {
        Some(&self.file)
    }

    fn memory_bytes(&self) -> u64 {
        size_of::<Self>() as u64
    }

    fn read_chunk(&self, chunk: usize, primitives: &mut Vec<P>) -> anyhow::Result<()> {
        primitives.clear();
        Ok(P::read(&self.file, self.file.body_chunks(self.body).start + chunk, primitives)?)
    }

    fn read_maps(&self, level: &dyn Fn(&MapHeader) -> u8) -> anyhow::Result<Vec<Arc<HeightMap>>> {
        Ok(self.file.read_maps(self.body, level)?)
    }
}

/// A body in memory, for tests and benchmarks.
#[derive(Clone, Debug)]
pub struct MemoryChunks<P: BodyPrimitive> {
    quantum_um: f64,
    header: P::Header,
    primitives: Vec<P>,
    chunk_primitives: usize,
}

/// A lattice in memory.
pub type MemoryStruts = MemoryChunks<Strut>;

/// A surface in memory.
pub type MemoryTriangles = MemoryChunks<Triangle>;

impl<P: BodyPrimitive> MemoryChunks<P> {
    /// Sorts `primitives` (stably) and divides them into chunks of `chunk_primitives`, 1 to 8192.
    pub fn new(quantum_um: f64, header: P::Header, mut primitives: Vec<P>, chunk_primitives: usize) -> Self {
        primitives.sort_by_key(P::order);
        Self { quantum_um, header, primitives, chunk_primitives: chunk_primitives.clamp(1, MAX_CHUNK_PRIMITIVES) }
    }

    fn chunk(&self, chunk: usize) -> &[P] {
        let end = ((chunk + 1) * self.chunk_primitives).min(self.primitives.len());
        &self.primitives[chunk * self.chunk_primitives..end]
    }
}

impl<P: BodyPrimitive> ChunkSource<P> for MemoryChunks<P> {
    fn header(&self) -> &P::Header {
        &self.header
    }

    fn quantum_um(&self) -> f64 {
        self.quantum_um
    }

    fn chunk_count(&self) -> usize {
        self.primitives.len().div_ceil(self.chunk_primitives)
    }

    fn chunk_primitives(&self) -> usize {
        self.chunk_primitives.min(self.primitives.len())
    }

    fn chunk_span(&self, chunk: usize) -> ChunkSpan {
        let primitives = self.chunk(chunk);
        let highest_z = primitives.iter().map(|primitive| primitive.z_range()[1]).max().unwrap_or(i32::MIN);
        ChunkSpan { lowest_z: primitives[0].z_range()[0], highest_z }
    }

    fn peak_active(&self) -> u64 {
        self.primitives.len() as u64
    }

    fn memory_bytes(&self) -> u64 {
        (self.primitives.len() * size_of::<P>()) as u64
    }

    fn read_chunk(&self, chunk: usize, primitives: &mut Vec<P>) -> anyhow::Result<()> {
        primitives.clear();
        primitives.extend_from_slice(self.chunk(chunk));
        Ok(())
    }
}
