//! Writing: struts go in in ascending order and come out as a whole file or none.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::num::NonZero;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::bottom::lowest_of_convolution;
use super::chunk::CHUNK_STRUTS;
use super::encoders::{Encoded, Encoders};
use super::error::BuildFileError;
use super::format::{self, Footer};
use super::index::ChunkEntry;
use super::lowest::LowestOfUnion;
use super::nodes::NodeCounter;
use super::profile::ProfileBuilder;
use super::reader::BuildFile;
use crate::buildfile::model::node_key;
use crate::buildfile::model::{Blend, BodyHeader, Bounds, Header, Lattice, Placement, Strut};
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
    /// Where the part stands.
    pub placement: Placement,
    /// SHA-256 of the source.
    pub source_digest: [u8; 32],
    /// Name of the source, cut to at most 255 bytes.
    pub source_name: String,
    /// What the part will be made of, in this order; 1 to [`Header::MAX_BODIES`].
    pub bodies: Vec<BodySettings>,
}

/// What a writer must know before the first primitive of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BodySettings {
    /// Struts and balls.
    Lattice {
        /// How they are joined.
        blend: Blend,
        /// None is thicker, quanta.
        largest_radius: u32,
    },
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

/// Writes a build file body by body, each from struts in ascending order of (z, y, x) of their lower, then of their upper node.
pub struct Writer {
    path: PathBuf,
    /// Of the bodies, those that are finished.
    header: Header,
    /// Bodies that are still to come, the next one last.
    to_come: Vec<BodySettings>,
    body: Growing,
    /// Declared before `output`, so that buffered bytes are gone when the file is closed.
    file: BufWriter<File>,
    output: Output,
    encoders: Encoders,
    offset: u64,
    pending: Vec<Strut>,
    index: Vec<ChunkEntry>,
    /// Of finished bodies.
    profiles: Vec<u8>,
    /// The lowest solid point of each finished body, micrometres; of a convolution at first the lower end of its bounds.
    bottoms_um: Vec<f64>,
}

/// The body that is being written.
struct Growing {
    lattice: Lattice,
    largest_radius: u32,
    reach: i64,
    profile: ProfileBuilder,
    nodes: NodeCounter,
    lowest: LowestOfUnion,
    last: Option<Strut>,
}

impl Growing {
    fn new(settings: BodySettings, quantum_um: f64) -> Self {
        let BodySettings::Lattice { blend, largest_radius } = settings;
        let lattice = Lattice {
            blend,
            bounds: Bounds::EMPTY,
            radius_range: [u32::MAX, 0],
            strut_count: 0,
            ball_count: 0,
            node_count: 0,
        };
        let reach = probe(settings).reach_quanta(quantum_um);
        Self {
            lattice,
            largest_radius,
            reach,
            profile: ProfileBuilder::default(),
            nodes: NodeCounter::default(),
            lowest: LowestOfUnion::default(),
            last: None,
        }
    }

    /// # Errors
    /// A text where the strut reaches beyond ±2³¹ quanta.
    fn add(&mut self, strut: Strut) -> Result<(), String> {
        let Lattice { bounds, radius_range, strut_count, ball_count, .. } = &mut self.lattice;
        *bounds = bounds.with(&strut).ok_or_else(|| format!("{strut:?} reaches beyond ±2³¹ quanta"))?;
        let [least, most] = [strut.radius_a.min(strut.radius_b), strut.radius_a.max(strut.radius_b)];
        *radius_range = [radius_range[0].min(least), radius_range[1].max(most)];
        *if strut.is_ball() { ball_count } else { strut_count } += 1;
        self.profile.add(i64::from(strut.a[2]) - self.reach, i64::from(strut.b[2]) + self.reach);
        self.nodes.count(&strut);
        self.lowest.add(&strut);
        self.last = Some(strut);
        Ok(())
    }

    /// # Errors
    /// A text that says how the strut is out of order or not as [`Strut`] demands.
    fn check(&self, strut: &Strut) -> Result<(), String> {
        let ends = [strut.a, strut.b].map(node_key);
        if ends[0] > ends[1] {
            return Err(format!("{strut:?}: its lower node must come first"));
        }
        if self.last.is_some_and(|last| [last.a, last.b].map(node_key) > ends) {
            return Err(format!("{strut:?} comes after a higher one"));
        }
        let radii = [strut.radius_a, strut.radius_b];
        if radii.iter().any(|&radius| radius == 0 || radius > self.largest_radius) {
            return Err(format!("{strut:?}: radii from 1 to {} quanta are allowed", self.largest_radius));
        }
        if strut.is_ball() && strut.radius_a != strut.radius_b {
            return Err(format!("{strut:?}: a ball has one radius"));
        }
        Ok(())
    }
}

impl Writer {
    /// Begins a file that will replace `path` when finished, and its first body.
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
        let refused = |problem| WriteError::Refused { path: path.into(), problem };
        let mut to_come = settings.bodies.clone();
        let header = first_header(settings);
        // Stands in the file until the true one, of the same length, is known.
        let front = probe_header(&header, &to_come);
        let front = format::check_header(&front).and_then(|()| format::front(&front)).map_err(refused)?;
        to_come.reverse();
        let first = to_come.pop().ok_or_else(|| refused("no bodies".into()))?;
        let output = Output::create(path).map_err(io_error)?;
        let mut file = BufWriter::with_capacity(256 << 10, output.file().try_clone().map_err(io_error)?);
        file.write_all(&front).map_err(io_error)?;
        Ok(Self {
            path: path.into(),
            body: Growing::new(first, header.quantum_um),
            header,
            to_come,
            file,
            output,
            encoders: Encoders::new(threads).map_err(io_error)?,
            offset: front.len() as u64,
            pending: Vec::with_capacity(CHUNK_STRUTS),
            index: Vec::new(),
            profiles: Vec::new(),
            bottoms_um: Vec::new(),
        })
    }

    /// Adds one strut to the body under way, no lower than the one before it.
    ///
    /// # Errors
    /// [`WriteError`] where the strut is out of order or not as [`Strut`] demands, or the file system refuses.
    pub fn push(&mut self, strut: Strut) -> Result<(), WriteError> {
        let added = self.body.check(&strut).and_then(|()| self.body.add(strut));
        added.map_err(|problem| self.refused(problem))?;
        self.pending.push(strut);
        if self.pending.len() == CHUNK_STRUTS { self.flush() } else { Ok(()) }
    }

    /// Ends the body under way and begins the next one.
    ///
    /// # Errors
    /// [`WriteError`] where the body is empty, there is no next one, or the file system refuses.
    pub fn next_body(&mut self) -> Result<(), WriteError> {
        let Some(next) = self.to_come.pop() else {
            return Err(self.refused("it has no more bodies than its settings said".into()));
        };
        self.end_body()?;
        self.body = Growing::new(next, self.header.quantum_um);
        Ok(())
    }

    /// Writes what is pending of the body under way and adds it to the header.
    fn end_body(&mut self) -> Result<(), WriteError> {
        if !self.pending.is_empty() {
            self.flush()?;
        }
        while self.write_oldest().map_err(|source| WriteError::Io { path: self.path.clone(), source })?.is_some() {}
        let Growing { lattice, profile, nodes, lowest, .. } = &self.body;
        if lattice.total() == 0 {
            return Err(self.refused(format!("body {} has no struts", self.header.bodies.len())));
        }
        let lattice = Lattice { node_count: nodes.total(), ..lattice.clone() };
        profile.append_to(&mut self.profiles);
        let quantum_um = self.header.quantum_um;
        self.bottoms_um.push(match lattice.blend {
            Blend::Union => lowest.um(quantum_um),
            // Until the file can be read.
            Blend::Convolution { .. } => lattice.bounds.bottom_um(quantum_um),
        });
        self.header.bounds = self.header.bounds.joined(&lattice.bounds);
        self.header.bodies.push(BodyHeader::Lattice(lattice));
        Ok(())
    }

    /// Completes the file, syncs it and gives it its name.
    ///
    /// # Errors
    /// [`WriteError`] where a body is missing or empty or the file system refuses; nothing stays behind then.
    pub fn finish(mut self) -> Result<Header, WriteError> {
        if !self.to_come.is_empty() {
            return Err(self.refused(format!("{} of its bodies are missing", self.to_come.len())));
        }
        self.end_body()?;
        self.header.bottom_um = least(&self.bottoms_um);
        if let Err(problem) = format::check_header(&self.header) {
            return Err(self.refused(problem));
        }
        let front = format::front(&self.header).map_err(|problem| self.refused(problem))?;
        let Self { path, mut header, output, file, index, profiles, offset, mut bottoms_um, .. } = self;
        let io_error = |source| WriteError::Io { path: path.clone(), source };
        complete(file, &front, &index, &profiles, offset).map_err(io_error)?;
        if header.lattices().any(|lattice| lattice.blend != Blend::Union) {
            let refused = |problem: String| WriteError::Refused { path: path.clone(), problem };
            let whole = BuildFile::of(&path, output.file().try_clone().map_err(io_error)?);
            let found = whole.and_then(|file| find_bottoms(&file, &mut bottoms_um));
            found.map_err(|error| refused(error.to_string()))?;
            header.bottom_um = least(&bottoms_um);
            let front = format::front(&header).map_err(refused)?;
            output.file().write_all_at(&front, 0).map_err(io_error)?;
        }
        output.persist().map_err(io_error)?;
        Ok(header)
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
        // No chunk of another body is under way: each is written whole before the next one begins.
        let body = self.header.bodies.len() as u16;
        self.index.push(ChunkEntry { offset: self.offset, body, ..entry });
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
    profiles: &[u8],
    index_offset: u64,
) -> io::Result<()> {
    let mut index_crc = crc32fast::Hasher::new();
    for entry in index {
        let bytes = codec::encode(entry).map_err(io::Error::other)?;
        index_crc.update(&bytes);
        file.write_all(&bytes)?;
    }
    let profile = zstd::bulk::compress(profiles, PROFILE_LEVEL)?;
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
    let WriterSettings { quantum_um, placement, source_digest, mut source_name, .. } = settings;
    let cut = (0..=format::SOURCE_NAME_LIMIT_BYTES.min(source_name.len())).rev();
    let cut = cut.into_iter().find(|&end| source_name.is_char_boundary(end)).unwrap_or(0);
    source_name.truncate(cut);
    Header {
        quantum_um,
        bounds: Bounds::EMPTY,
        bottom_um: 0.0,
        placement,
        source_digest,
        source_name,
        bodies: Vec::new(),
    }
}

/// The header with the smallest bodies of such settings.
fn probe_header(header: &Header, bodies: &[BodySettings]) -> Header {
    let lattices: Vec<_> = bodies.iter().copied().map(probe).collect();
    let bounds = lattices.iter().fold(Bounds::EMPTY, |bounds, lattice| bounds.joined(&lattice.bounds));
    Header { bounds, bodies: lattices.into_iter().map(BodyHeader::Lattice).collect(), ..header.clone() }
}

/// One ball of the largest radius.
fn probe(BodySettings::Lattice { blend, largest_radius }: BodySettings) -> Lattice {
    let reached = largest_radius.min(LARGEST_RADIUS) as i32;
    Lattice {
        blend,
        bounds: Bounds { min: [-reached; 3], max: [reached; 3] },
        radius_range: [largest_radius; 2],
        strut_count: 0,
        ball_count: 1,
        node_count: 0,
    }
}

/// Finds the lowest solid points of the bodies that are convolutions.
fn find_bottoms(file: &BuildFile, bottoms_um: &mut [f64]) -> Result<(), BuildFileError> {
    for (body, (lattice, bottom_um)) in file.header().lattices().zip(bottoms_um).enumerate() {
        if let Blend::Convolution { support_um } = lattice.blend
            && let Some(found_um) = lowest_of_convolution(file, body, lattice, support_um)?
        {
            *bottom_um = found_um;
        }
    }
    Ok(())
}

fn least(heights_um: &[f64]) -> f64 {
    heights_um.iter().copied().fold(f64::INFINITY, f64::min)
}
