//! Where the sweep gets its struts: chunks in ascending order of the lowest z.

use std::sync::Arc;

use crate::buildfile::{BuildFile, CHUNK_STRUTS, Lattice, Strut};

/// Where a chunk's struts lie, in quanta.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkSpan {
    /// Lowest `a[2]` of its struts.
    pub lowest_z: i32,
    /// Highest `b[2]` of its struts.
    pub highest_z: i32,
}

/// A lattice whose struts can be read chunk by chunk, in ascending order of `a[2]`.
pub trait StrutSource: Send + Sync {
    /// The lattice.
    fn lattice(&self) -> &Lattice;

    /// Length of a quantum, micrometres.
    fn quantum_um(&self) -> f64;

    /// Number of chunks.
    fn chunk_count(&self) -> usize;

    /// Where the struts of a chunk lie. Lowest z ascends from chunk to chunk.
    fn chunk_span(&self, chunk: usize) -> ChunkSpan;

    /// Most struts that can be within reach of one plane; known before any chunk is read.
    fn peak_active(&self) -> u64;

    /// Bytes the source holds beside the struts it hands out, at most, when `threads` read from it.
    fn memory_bytes(&self, threads: usize) -> u64;

    /// Replaces `struts` by those of a chunk.
    ///
    /// # Errors
    /// Whatever keeps the chunk from being read, naming file and place.
    fn read_chunk(&self, chunk: usize, struts: &mut Vec<Strut>) -> anyhow::Result<()>;
}

/// One lattice of a build file.
pub(in crate::slice) struct StoredLattice {
    pub(in crate::slice) file: Arc<BuildFile>,
    pub(in crate::slice) body: usize,
    /// As it is to be drawn.
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

    fn memory_bytes(&self, threads: usize) -> u64 {
        (self.file.memory_bytes() + threads * self.file.scratch_bytes()) as u64
    }

    fn read_chunk(&self, chunk: usize, struts: &mut Vec<Strut>) -> anyhow::Result<()> {
        struts.clear();
        Ok(self.file.read_chunk(self.file.body_chunks(self.body).start + chunk, struts)?)
    }
}

/// Struts in memory as a source, for tests and benchmarks.
#[derive(Clone, Debug)]
pub struct MemoryStruts {
    quantum_um: f64,
    lattice: Lattice,
    struts: Vec<Strut>,
    chunk_struts: usize,
}

impl MemoryStruts {
    /// Sorts `struts` (stably) and cuts them into chunks of `chunk_struts`, at least 1 and at most [`CHUNK_STRUTS`].
    pub fn new(quantum_um: f64, lattice: Lattice, mut struts: Vec<Strut>, chunk_struts: usize) -> Self {
        struts.sort_by_key(|strut| strut.a[2]);
        Self { quantum_um, lattice, struts, chunk_struts: chunk_struts.clamp(1, CHUNK_STRUTS) }
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

    fn memory_bytes(&self, _threads: usize) -> u64 {
        (self.struts.len() * size_of::<Strut>()) as u64
    }

    fn read_chunk(&self, chunk: usize, struts: &mut Vec<Strut>) -> anyhow::Result<()> {
        struts.clear();
        struts.extend_from_slice(self.chunk(chunk));
        Ok(())
    }
}
