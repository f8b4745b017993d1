//! Writing: struts go in in ascending order and come out as a whole file or none.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::num::NonZero;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::bottom::lowest_of_convolution;
use super::chunk::CHUNK_STRUTS;
use super::encoders::{Encoded, Encoders};
use super::format::{self, Footer};
use super::index::ChunkEntry;
use super::lowest::LowestOfUnion;
use super::nodes::NodeCounter;
use super::profile::ProfileBuilder;
use super::reader::BuildFile;
use crate::buildfile::model::node_key;
use crate::buildfile::model::{Blend, Bounds, Header, Placement, Strut};
use crate::codec;
use crate::output::Output;
use crate::solid::LARGEST_RADIUS;

/// Compression level of the profile, of which there is one in a file.
const PROFILE_LEVEL: i32 = 9;

/// Bytes of a strut in a build file: what a large file takes at most in practice.
pub(in crate::buildfile) const EXPECTED_STRUT_BYTES: u64 = 10;

/// What a writer must know before the first strut.
#[derive(Clone, Debug, PartialEq)]
pub struct WriterSettings {
    /// Length of one quantum in micrometres.
    pub quantum_um: f64,
    /// How struts are joined.
    pub blend: Blend,
    /// No strut is thicker, quanta.
    pub largest_radius: u32,
    /// Where the part stands.
    pub placement: Placement,
    /// SHA-256 of the source.
    pub source_digest: [u8; 32],
    /// Name of the source, cut to at most 255 bytes.
    pub source_name: String,
}

/// A build file that could not be written. Nothing half-written stays behind.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file system refused.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// The file that was to be written.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A strut, or the settings, cannot stand in a build file.
    #[error("cannot write {}: {problem}", path.display())]
    Refused {
        /// The file that was to be written.
        path: PathBuf,
        /// What is wrong and what is allowed.
        problem: String,
    },
}

/// Writes a build file from struts in ascending order of (z, y, x) of their lower, then of their upper node.
pub struct Writer {
    path: PathBuf,
    header: Header,
    reach: i64,
    largest_radius: u32,
    /// Declared before `output`, so that buffered bytes are gone when the file is closed.
    file: BufWriter<File>,
    output: Output,
    encoders: Encoders,
    offset: u64,
    pending: Vec<Strut>,
    index: Vec<ChunkEntry>,
    profile: ProfileBuilder,
    nodes: NodeCounter,
    lowest: LowestOfUnion,
    last: Option<Strut>,
}

impl Writer {
    /// Begins a file that will replace `path` when finished.
    ///
    /// # Errors
    /// [`WriteError`] where the settings contradict themselves or the place cannot be written to.
    pub fn create(path: &Path, settings: WriterSettings) -> Result<Self, WriteError> {
        let threads = std::thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN);
        Self::with_threads(path, settings, threads)
    }

    /// As [`Writer::create`], with so many threads that compress; the file does not depend on their number.
    pub(in crate::buildfile) fn with_threads(
        path: &Path,
        settings: WriterSettings,
        threads: NonZero<usize>,
    ) -> Result<Self, WriteError> {
        let io_error = |source| WriteError::Io { path: path.into(), source };
        let largest_radius = settings.largest_radius;
        let header = first_header(settings);
        // Stands in the file until the true one, of the same length, is known.
        let reached = largest_radius.min(LARGEST_RADIUS) as i32;
        let probe = Header {
            bounds: Bounds { min: [-reached; 3], max: [reached; 3] },
            radius_range: [largest_radius; 2],
            strut_count: 1,
            bottom_um: 0.0,
            ..header.clone()
        };
        let front = format::check_header(&probe).and_then(|()| format::front(&probe));
        let front = front.map_err(|problem| WriteError::Refused { path: path.into(), problem })?;
        let output = Output::create(path).map_err(io_error)?;
        let mut file = BufWriter::with_capacity(256 << 10, output.file().try_clone().map_err(io_error)?);
        file.write_all(&front).map_err(io_error)?;
        Ok(Self {
            path: path.into(),
            reach: probe.reach_quanta(),
            largest_radius,
            header,
            file,
            output,
            encoders: Encoders::new(threads).map_err(io_error)?,
            offset: front.len() as u64,
            pending: Vec::with_capacity(CHUNK_STRUTS),
            index: Vec::new(),
            profile: ProfileBuilder::default(),
            nodes: NodeCounter::default(),
            lowest: LowestOfUnion::default(),
            last: None,
        })
    }

    /// Adds one strut, no lower than the one before it.
    ///
    /// # Errors
    /// [`WriteError`] where the strut is out of order or not as [`Strut`] demands, or the file system refuses.
    pub fn push(&mut self, strut: Strut) -> Result<(), WriteError> {
        self.check(&strut)?;
        let bounds = self.header.bounds.with(&strut);
        self.header.bounds = bounds.ok_or_else(|| self.refused(format!("{strut:?} reaches beyond ±2³¹ quanta")))?;
        let radii = [strut.radius_a, strut.radius_b];
        let range = &mut self.header.radius_range;
        *range = [range[0].min(radii[0]).min(radii[1]), range[1].max(radii[0]).max(radii[1])];
        *if strut.is_ball() { &mut self.header.ball_count } else { &mut self.header.strut_count } += 1;
        self.profile.add(i64::from(strut.a[2]) - self.reach, i64::from(strut.b[2]) + self.reach);
        self.nodes.count(&strut);
        self.lowest.add(&strut);
        self.last = Some(strut);
        self.pending.push(strut);
        if self.pending.len() == CHUNK_STRUTS { self.flush() } else { Ok(()) }
    }

    /// Completes the file, syncs it and gives it its name.
    ///
    /// # Errors
    /// [`WriteError`] where no strut was added or the file system refuses; nothing stays behind then.
    pub fn finish(mut self) -> Result<Header, WriteError> {
        if !self.pending.is_empty() {
            self.flush()?;
        }
        while self.write_oldest().map_err(|source| WriteError::Io { path: self.path.clone(), source })?.is_some() {}
        self.header.node_count = self.nodes.total();
        self.header.bottom_um = match self.header.blend {
            Blend::Union => self.lowest.um(self.header.quantum_um),
            // Until the file can be read.
            Blend::Convolution { .. } => self.header.bounds_bottom_um(),
        };
        if let Err(problem) = format::check_header(&self.header) {
            return Err(self.refused(problem));
        }
        let front = format::front(&self.header).map_err(|problem| self.refused(problem))?;
        let Self { path, mut header, output, file, index, profile, offset, .. } = self;
        let io_error = |source| WriteError::Io { path: path.clone(), source };
        complete(file, &front, &index, &profile, offset).map_err(io_error)?;
        if let Blend::Convolution { support_um } = header.blend {
            let refused = |problem: String| WriteError::Refused { path: path.clone(), problem };
            let whole = BuildFile::of(&path, output.file().try_clone().map_err(io_error)?);
            let bottom_um = whole.and_then(|file| lowest_of_convolution(&file, support_um));
            if let Some(bottom_um) = bottom_um.map_err(|error| refused(error.to_string()))? {
                header.bottom_um = bottom_um;
            }
            let front = format::front(&header).map_err(refused)?;
            output.file().write_all_at(&front, 0).map_err(io_error)?;
        }
        output.persist().map_err(io_error)?;
        Ok(header)
    }

    fn check(&self, strut: &Strut) -> Result<(), WriteError> {
        let ends = [strut.a, strut.b].map(node_key);
        if ends[0] > ends[1] {
            return Err(self.refused(format!("{strut:?}: its lower node must come first")));
        }
        if self.last.is_some_and(|last| [last.a, last.b].map(node_key) > ends) {
            return Err(self.refused(format!("{strut:?} comes after a higher one")));
        }
        let radii = [strut.radius_a, strut.radius_b];
        if radii.iter().any(|&radius| radius == 0 || radius > self.largest_radius) {
            return Err(self.refused(format!("{strut:?}: radii from 1 to {} quanta are allowed", self.largest_radius)));
        }
        if strut.is_ball() && strut.radius_a != strut.radius_b {
            return Err(self.refused(format!("{strut:?}: a ball has one radius")));
        }
        Ok(())
    }

    /// Sends the pending struts to be compressed.
    fn flush(&mut self) -> Result<(), WriteError> {
        let sent = self.send();
        sent.map_err(|source| WriteError::Io { path: self.path.clone(), source })
    }

    fn send(&mut self) -> io::Result<()> {
        let empty = if self.encoders.is_full() { self.write_oldest()? } else { None };
        let empty = empty.unwrap_or_else(|| Vec::with_capacity(CHUNK_STRUTS));
        self.encoders.send(std::mem::replace(&mut self.pending, empty))
    }

    /// Writes the oldest chunk under way and returns its buffer of struts, emptied; `None` where all are written.
    fn write_oldest(&mut self) -> io::Result<Option<Vec<Strut>>> {
        let Some(Encoded { entry, packed, mut struts }) = self.encoders.receive()? else { return Ok(None) };
        self.file.write_all(&packed)?;
        self.index.push(ChunkEntry { offset: self.offset, ..entry });
        self.offset += packed.len() as u64;
        struts.clear();
        Ok(Some(struts))
    }

    fn refused(&self, problem: String) -> WriteError {
        WriteError::Refused { path: self.path.clone(), problem }
    }
}

/// Writes index, profile and footer, then the final header over the first one, which has the same length.
fn complete(
    mut file: BufWriter<File>,
    front: &[u8],
    index: &[ChunkEntry],
    profile: &ProfileBuilder,
    index_offset: u64,
) -> io::Result<()> {
    let mut index_crc = crc32fast::Hasher::new();
    for entry in index {
        let bytes = codec::encode(entry).map_err(io::Error::other)?;
        index_crc.update(&bytes);
        file.write_all(&bytes)?;
    }
    let profile = zstd::bulk::compress(&profile.to_bytes(), PROFILE_LEVEL)?;
    file.write_all(&profile)?;
    let footer = Footer {
        index_offset,
        chunk_count: u32::try_from(index.len()).map_err(io::Error::other)?,
        index_crc: index_crc.finalize(),
        profile_bytes: profile.len() as u32,
        profile_crc: crc32fast::hash(&profile),
    };
    file.write_all(&footer.to_bytes())?;
    file.seek(SeekFrom::Start(0))?;
    file.write_all(front)?;
    file.flush()
}

fn first_header(settings: WriterSettings) -> Header {
    let WriterSettings { quantum_um, blend, placement, source_digest, mut source_name, .. } = settings;
    let cut = (0..=format::SOURCE_NAME_LIMIT_BYTES.min(source_name.len())).rev();
    let cut = cut.into_iter().find(|&end| source_name.is_char_boundary(end)).unwrap_or(0);
    source_name.truncate(cut);
    Header {
        quantum_um,
        blend,
        bounds: Bounds::EMPTY,
        radius_range: [u32::MAX, 0],
        strut_count: 0,
        ball_count: 0,
        node_count: 0,
        placement,
        source_digest,
        source_name,
        bottom_um: 0.0,
    }
}
