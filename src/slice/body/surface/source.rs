//! Sources of triangles for the sweep: chunks in ascending order of their lowest z. `sweep` reads from them.

use std::sync::Arc;

use crate::buildfile::{BuildFile, MAX_CHUNK_PRIMITIVES, Surface, Triangle};
use crate::slice::body::feed::{ChunkSpan, Chunks};

/// A surface that can be read chunk by chunk. Its triangles are in ascending order of their lowest corners.
pub trait TriangleSource: Send + Sync {
    /// Length of a quantum, micrometres.
    fn quantum_um(&self) -> f64;

    /// Number of chunks.
    fn chunk_count(&self) -> usize;

    /// Range of z of a chunk. The lowest z ascends from chunk to chunk.
    fn chunk_span(&self, chunk: usize) -> ChunkSpan;

    /// Upper bound of the number of triangles that any plane cuts. It is known before a chunk is read.
    fn peak_active(&self) -> u64;

    /// The open build file that the source reads, if it reads one. Bodies of one file share its memory, so it is counted once.
    fn file(&self) -> Option<&Arc<BuildFile>> {
        None
    }

    /// Memory of the source itself, bytes, at most: without [`TriangleSource::file`] and the triangles it hands out.
    fn memory_bytes(&self) -> u64;

    /// Replaces the contents of `triangles` with the triangles of a chunk.
    ///
    /// # Errors
    /// If the chunk cannot be read; names the file and the place in it.
    fn read_chunk(&self, chunk: usize, triangles: &mut Vec<Triangle>) -> anyhow::Result<()>;
}

impl Chunks<Triangle> for dyn TriangleSource {
    fn count(&self) -> usize {
        self.chunk_count()
    }

    fn span(&self, chunk: usize) -> ChunkSpan {
        self.chunk_span(chunk)
    }

    fn read(&self, chunk: usize, triangles: &mut Vec<Triangle>) -> anyhow::Result<()> {
        self.read_chunk(chunk, triangles)
    }
}

/// One surface of a build file.
pub(in crate::slice) struct StoredSurface {
    pub(in crate::slice) file: Arc<BuildFile>,
    pub(in crate::slice) body: usize,
}

impl TriangleSource for StoredSurface {
    fn quantum_um(&self) -> f64 {
        self.file.header().quantum_um
    }

    fn chunk_count(&self) -> usize {
        self.file.body_chunks(self.body).len()
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

    fn read_chunk(&self, chunk: usize, triangles: &mut Vec<Triangle>) -> anyhow::Result<()> {
        triangles.clear();
        Ok(self.file.read_triangles(self.file.body_chunks(self.body).start + chunk, triangles)?)
    }
}

/// A source of triangles in memory, for tests and benchmarks.
#[derive(Clone, Debug)]
pub struct MemoryTriangles {
    quantum_um: f64,
    triangles: Vec<Triangle>,
    chunk_triangles: usize,
}

impl MemoryTriangles {
    /// Sorts `triangles` and divides them into chunks of `chunk_triangles`, 1 to 8192.
    pub fn new(quantum_um: f64, mut triangles: Vec<Triangle>, chunk_triangles: usize) -> Self {
        triangles.sort_by_key(|triangle| triangle.corners[0][2]);
        Self { quantum_um, triangles, chunk_triangles: chunk_triangles.clamp(1, MAX_CHUNK_PRIMITIVES) }
    }

    /// The smallest box of whole quanta around all triangles.
    pub fn surface(&self) -> Surface {
        Surface::of(&self.triangles)
    }

    fn chunk(&self, chunk: usize) -> &[Triangle] {
        let end = ((chunk + 1) * self.chunk_triangles).min(self.triangles.len());
        &self.triangles[chunk * self.chunk_triangles..end]
    }
}

impl TriangleSource for MemoryTriangles {
    fn quantum_um(&self) -> f64 {
        self.quantum_um
    }

    fn chunk_count(&self) -> usize {
        self.triangles.len().div_ceil(self.chunk_triangles)
    }

    fn chunk_span(&self, chunk: usize) -> ChunkSpan {
        let bounds = Surface::of(self.chunk(chunk)).bounds;
        ChunkSpan { lowest_z: bounds.min[2], highest_z: bounds.max[2] }
    }

    fn peak_active(&self) -> u64 {
        self.triangles.len() as u64
    }

    fn memory_bytes(&self) -> u64 {
        (self.triangles.len() * size_of::<Triangle>()) as u64
    }

    fn read_chunk(&self, chunk: usize, triangles: &mut Vec<Triangle>) -> anyhow::Result<()> {
        triangles.clear();
        triangles.extend_from_slice(self.chunk(chunk));
        Ok(())
    }
}
