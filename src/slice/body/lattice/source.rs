//! Sources of struts for the sweep: chunks in ascending order of their lowest z. `sweep` reads from them.

use std::sync::Arc;

use crate::buildfile::{BuildFile, Lattice, MAX_CHUNK_PRIMITIVES, Strut};
use crate::slice::body::feed::{ChunkSpan, Chunks};

/// A lattice that can be read chunk by chunk. Its struts are in ascending order of `a[2]`.
pub trait StrutSource: Send + Sync {
    /// The lattice.
    fn lattice(&self) -> &Lattice;

    /// Length of a quantum, micrometres.
    fn quantum_um(&self) -> f64;

    /// Number of chunks.
    fn chunk_count(&self) -> usize;

    /// Range of z of a chunk. The lowest z ascends from chunk to chunk.
    fn chunk_span(&self, chunk: usize) -> ChunkSpan;

    /// Upper bound of the number of struts within reach of any plane. It is known before a chunk is read.
    fn peak_active(&self) -> u64;

    /// The open build file that the source reads, if it reads one. Bodies of one file share its memory, so it is counted once.
    fn file(&self) -> Option<&Arc<BuildFile>> {
        None
    }

    /// Memory of the source itself, bytes, at most: without [`StrutSource::file`] and the struts it hands out.
    fn memory_bytes(&self) -> u64;

    /// Replaces the contents of `struts` with the struts of a chunk.
    ///
    /// # Errors
    /// If the chunk cannot be read; names the file and the place in it.
    fn read_chunk(&self, chunk: usize, struts: &mut Vec<Strut>) -> anyhow::Result<()>;
}

impl Chunks<Strut> for dyn StrutSource {
    fn count(&self) -> usize {
        self.chunk_count()
    }

    fn span(&self, chunk: usize) -> ChunkSpan {
        self.chunk_span(chunk)
    }

    fn read(&self, chunk: usize, struts: &mut Vec<Strut>) -> anyhow::Result<()> {
        self.read_chunk(chunk, struts)
    }
}

/// One lattice of a build file.
pub(in crate::slice) struct StoredLattice {
    pub(in crate::slice) file: Arc<BuildFile>,
    pub(in crate::slice) body: usize,
    /// The header, with the blend to be drawn.
    pub(in crate::slice) lattice: Lattice,
}

impl StrutSource for StoredLattice {
    fn lattice(&self) -> &Lattice {
        &self.lattice
    }

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

    fn read_chunk(&self, chunk: usize, struts: &mut Vec<Strut>) -> anyhow::Result<()> {
        struts.clear();
        Ok(self.file.read_chunk(self.file.body_chunks(self.body).start + chunk, struts)?)
    }
}

/// A source of struts in memory, for tests and benchmarks.
#[derive(Clone, Debug)]
pub struct MemoryStruts {
    quantum_um: f64,
    lattice: Lattice,
    struts: Vec<Strut>,
    chunk_struts: usize,
}

impl MemoryStruts {
    /// Sorts `struts` (stably) and divides them into chunks of `chunk_struts`, 1 to 8192.
    pub fn new(quantum_um: f64, lattice: Lattice, mut struts: Vec<Strut>, chunk_struts: usize) -> Self {
        struts.sort_by_key(|strut| strut.a[2]);
        Self { quantum_um, lattice, struts, chunk_struts: chunk_struts.clamp(1, MAX_CHUNK_PRIMITIVES) }
    }

    fn chunk(&self, chunk: usize) -> &[Strut] {
        let end = ((chunk + 1) * self.chunk_struts).min(self.struts.len());
        &self.struts[chunk * self.chunk_struts..end]
    }
}

impl StrutSource for MemoryStruts {
    fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    fn quantum_um(&self) -> f64 {
        self.quantum_um
    }

    fn chunk_count(&self) -> usize {
        self.struts.len().div_ceil(self.chunk_struts)
    }

    fn chunk_span(&self, chunk: usize) -> ChunkSpan {
        let struts = self.chunk(chunk);
        let highest_z = struts.iter().map(|strut| strut.b[2]).max().unwrap_or(i32::MIN);
        ChunkSpan { lowest_z: struts[0].a[2], highest_z }
    }

    fn peak_active(&self) -> u64 {
        self.struts.len() as u64
    }

    fn memory_bytes(&self) -> u64 {
        (self.struts.len() * size_of::<Strut>()) as u64
    }

    fn read_chunk(&self, chunk: usize, struts: &mut Vec<Strut>) -> anyhow::Result<()> {
        struts.clear();
        struts.extend_from_slice(self.chunk(chunk));
        Ok(())
    }
}
