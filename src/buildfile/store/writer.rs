//! Writing: primitives are added in ascending order; the file appears complete or not at all. [`buildfile`](crate::buildfile) has an
//! example.

use std::io;
use std::num::NonZero;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::bottom::lowest_of_convolution;
use super::chunker::{ChunkFile, Chunker};
use super::clipped::range_of_clipped;
use super::control_points::least_fields;
use super::error::BuildFileError;
use super::format;
use super::lattice::LatticeBuilder;
use super::profile::ProfileBuilder;
use super::reader::BuildFile;
use super::relief::ReliefBuilder;
use super::settings::{BodySettings, WriteError, WriterSettings};
use super::surface::SurfaceBuilder;
use crate::buildfile::model::{BodyHeader, Clip, Header, Joint, Keeps, Lattice, Strut, Triangle, printed_bounds};
use crate::buildfile::relief::Patch;
use crate::output::Output;

/// Writes a build file body by body. The struts of a lattice come in ascending order of (z, y, x) of their lower, then of their upper node;
/// the triangles of a surface in that of their corners; the
/// patches of a relief in that of their lowest z, and then as they compare.
pub struct Writer {
    path: PathBuf,
    /// With the bodies that are finished.
    header: Header,
    /// Bodies that are still to come, the next one last.
    to_come: Vec<BodySettings>,
    body: OpenBody,
    threads: NonZero<usize>,
    /// Declared before `output`, so that its buffer is dropped before the file is closed.
    chunks: ChunkFile,
    output: Output,
    /// Of finished bodies.
    profiles: Vec<u8>,
    /// The lowest solid point of each finished body, micrometres.
    bottoms_um: Vec<f64>,
    /// Where the blend of two materials begins, quanta.
    control_points: Option<[[f64; 3]; 2]>,
}

/// The body that is being written.
enum OpenBody {
    Lattice(LatticeBuilder, Chunker<Strut>),
    Surface(SurfaceBuilder, Chunker<Triangle>),
    Relief(Box<ReliefBuilder>, Chunker<Patch>),
    Clip(Keeps, SurfaceBuilder, Chunker<Triangle>),
}

impl OpenBody {
    fn new(settings: BodySettings, quantum_um: f64, threads: NonZero<usize>) -> io::Result<Self> {
        Ok(match settings {
            BodySettings::Lattice { joint, largest_radius } => {
                Self::Lattice(LatticeBuilder::new(joint, largest_radius, quantum_um), Chunker::new(threads)?)
            }
            BodySettings::Surface => Self::Surface(SurfaceBuilder::new(), Chunker::new(threads)?),
            BodySettings::Clip { keeps } => Self::Clip(keeps, SurfaceBuilder::new(), Chunker::new(threads)?),
            BodySettings::Relief(settings) => {
                let relief = ReliefBuilder::new(&settings, quantum_um).map_err(io::Error::other)?;
                Self::Relief(Box::new(relief), Chunker::new(threads)?)
            }
        })
    }

    fn finish(&mut self, chunks: &mut ChunkFile) -> io::Result<()> {
        match self {
            Self::Lattice(_, struts) => struts.finish_body(chunks),
            Self::Surface(_, triangles) | Self::Clip(_, _, triangles) => triangles.finish_body(chunks),
            Self::Relief(relief, patches) => {
                relief.finish().map_err(io::Error::other)?;
                patches.finish_body(chunks)
            }
        }
    }

    /// Its header. The bounds of what a clip leaves are not known yet.
    fn header(&self) -> BodyHeader {
        match self {
            Self::Lattice(lattice, _) => BodyHeader::Lattice(lattice.header()),
            Self::Surface(surface, _) => BodyHeader::Surface(surface.header()),
            Self::Relief(relief, _) => BodyHeader::Relief(relief.header()),
            Self::Clip(keeps, surface, _) => {
                let surface = surface.header();
                BodyHeader::Clip(Clip { keeps: *keeps, bounds: surface.bounds, surface })
            }
        }
    }

    fn profile(&self) -> &ProfileBuilder {
        match self {
            Self::Lattice(lattice, _) => lattice.profile(),
            Self::Surface(surface, _) | Self::Clip(_, surface, _) => surface.profile(),
            Self::Relief(relief, _) => relief.profile(),
        }
    }

    fn bottom_um(&self, quantum_um: f64) -> f64 {
        match self {
            Self::Lattice(lattice, _) => lattice.bottom_um(quantum_um),
            Self::Surface(surface, _) | Self::Clip(_, surface, _) => surface.bottom_um(quantum_um),
            Self::Relief(relief, _) => relief.lowest() * quantum_um,
        }
    }
}

impl Writer {
    /// Begins a file, and its first body. The file replaces `path` when it is finished.
    ///
    /// # Errors
    /// [`WriteError`] if the settings contradict themselves or the directory cannot be written to.
    pub fn create(path: &Path, settings: WriterSettings) -> Result<Self, WriteError> {
        let threads = std::thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN);
        Self::with_threads(path, settings, threads)
    }

    /// As [`Writer::create`], with so many threads that compress. The file does not depend on their number.
    pub(in crate::buildfile) fn with_threads(
        path: &Path,
        settings: WriterSettings,
        threads: NonZero<usize>,
    ) -> Result<Self, WriteError> {
        let io_error = |source| WriteError::Io { path: path.into(), source };
        let refused = |problem| WriteError::Refused { path: path.into(), problem };
        let mut to_come = settings.bodies.clone();
        let header = settings.header();
        // A placeholder of the same length as the final header.
        let front = BodySettings::smallest_header(&header, &to_come);
        let front = format::check_header(&front).and_then(|()| format::front(&front)).map_err(refused)?;
        let maps: Vec<_> = to_come.iter().flat_map(BodySettings::maps).cloned().collect();
        to_come.reverse();
        let first = to_come.pop().ok_or_else(|| refused("no bodies".into()))?;
        let output = Output::create(path).map_err(io_error)?;
        let file = output.file().try_clone().map_err(io_error)?;
        let mut chunks = ChunkFile::begin(file, &front).map_err(io_error)?;
        maps.iter().try_for_each(|map| chunks.map(map)).map_err(io_error)?;
        Ok(Self {
            path: path.into(),
            body: OpenBody::new(first, header.quantum_um, threads).map_err(io_error)?,
            threads,
            header,
            to_come,
            chunks,
            output,
            profiles: Vec::new(),
            bottoms_um: Vec::new(),
            control_points: None,
        })
    }

    /// The blend of two materials, which are joined by elliptic arcs, is to begin at these points, quanta, whatever the settings say: the first on the
    /// surface of the first material, the second on that of the second.
    pub(in crate::buildfile) fn set_control_points(&mut self, points: [[f64; 3]; 2]) {
        self.control_points = Some(points);
    }

    /// Adds a strut to the current body. It must not be lower than the one before it.
    ///
    /// # Errors
    /// [`WriteError`] if the body is no lattice, the strut is out of order or not as [`Strut`] demands, or writing fails.
    pub fn push(&mut self, strut: Strut) -> Result<(), WriteError> {
        let OpenBody::Lattice(lattice, struts) = &mut self.body else {
            return Err(self.refused("a strut in another kind of body".into()));
        };
        if let Err(problem) = lattice.add(strut) {
            return Err(self.refused(problem));
        }
        let pushed = struts.push(strut, &mut self.chunks);
        pushed.map_err(|source| self.io_error(source))
    }

    /// Adds a triangle to the current body. It must not be lower than the one before it.
    ///
    /// # Errors
    /// [`WriteError`] if the body is no surface, the triangle is out of order or not as [`Triangle`] demands, or writing fails.
    pub fn push_triangle(&mut self, triangle: Triangle) -> Result<(), WriteError> {
        let (OpenBody::Surface(surface, triangles) | OpenBody::Clip(_, surface, triangles)) = &mut self.body else {
            return Err(self.refused("a triangle in another kind of body".into()));
        };
        if let Err(problem) = surface.add(triangle) {
            return Err(self.refused(problem));
        }
        let pushed = triangles.push(triangle, &mut self.chunks);
        pushed.map_err(|source| self.io_error(source))
    }

    /// Adds a patch to the current body. It must not be lower than the one before it.
    ///
    /// # Errors
    /// [`WriteError`] if the body is no relief, the patch is out of order or not as [`Patch`] demands, or writing fails.
    pub fn push_patch(&mut self, patch: Patch) -> Result<(), WriteError> {
        let OpenBody::Relief(relief, patches) = &mut self.body else {
            return Err(self.refused("a patch in a body without relief".into()));
        };
        if let Err(problem) = relief.add(patch) {
            return Err(self.refused(problem));
        }
        let pushed = patches.push(patch, &mut self.chunks);
        pushed.map_err(|source| self.io_error(source))
    }

    /// Ends the current body and begins the next one.
    ///
    /// # Errors
    /// [`WriteError`] if the body is empty, there is no next one, or writing fails.
    pub fn next_body(&mut self) -> Result<(), WriteError> {
        let Some(next) = self.to_come.pop() else {
            return Err(self.refused("it has no more bodies than its settings said".into()));
        };
        self.end_body()?;
        self.chunks.next_body();
        let body = OpenBody::new(next, self.header.quantum_um, self.threads);
        self.body = body.map_err(|source| self.io_error(source))?;
        Ok(())
    }

    /// Writes the last chunks of the current body and adds the body to the header.
    fn end_body(&mut self) -> Result<(), WriteError> {
        let written = self.body.finish(&mut self.chunks);
        written.map_err(|source| self.io_error(source))?;
        let (mut body, number) = (self.body.header(), self.header.bodies.len());
        if body.total() == 0 {
            return Err(self.refused(format!("body {number} is empty")));
        }
        self.body.profile().append_to(&mut self.profiles);
        let mut bottom_um = self.body.bottom_um(self.header.quantum_um);
        if let (BodyHeader::Clip(clip), Some(BodyHeader::Lattice(lattice))) = (&mut body, self.header.bodies.last()) {
            let limits = clip.limits(lattice, self.header.quantum_um);
            clip.bounds = limits.ok_or_else(|| WriteError::NothingLeft { path: self.path.clone(), body: number })?;
            bottom_um = clip.bounds.bottom_um(self.header.quantum_um);
            self.bottoms_um[number - 1] = f64::INFINITY;
        }
        self.bottoms_um.push(bottom_um);
        self.header.bodies.push(body);
        Ok(())
    }

    /// Completes the file, syncs it and gives it its name.
    ///
    /// # Errors
    /// [`WriteError`] if a body is missing or empty, or writing fails. Then no file stays behind.
    pub fn finish(mut self) -> Result<Header, WriteError> {
        if !self.to_come.is_empty() {
            return Err(self.refused(format!("{} of its bodies are missing", self.to_come.len())));
        }
        self.end_body()?;
        self.header.bounds = printed_bounds(&self.header.bodies);
        self.header.bottom_um = lowest(&self.bottoms_um);
        if let Err(problem) = format::check_header(&self.header) {
            return Err(self.refused(problem));
        }
        let front = format::front(&self.header).map_err(|problem| self.refused(problem))?;
        let Self { path, mut header, output, chunks, profiles, mut bottoms_um, control_points, .. } = self;
        let io_error = |source| WriteError::Io { path: path.clone(), source };
        chunks.complete(&front, &profiles).map_err(io_error)?;
        if !header.bodies.iter().all(BodyHeader::is_exact) {
            let refused = |problem: String| WriteError::Refused { path: path.clone(), problem };
            let whole = BuildFile::of(&path, output.file().try_clone().map_err(io_error)?.into());
            let file = whole.map_err(|error| refused(error.to_string()))?;
            if let Some(points) = &control_points {
                set_least_fields(&file, &mut header, points).map_err(refused)?;
            }
            let found = find_bottoms(&file, &mut header.bodies, &mut bottoms_um);
            if let Some(body) = found.map_err(|error| refused(error.to_string()))? {
                return Err(WriteError::NothingLeft { path, body });
            }
            header.bounds = printed_bounds(&header.bodies);
            header.bottom_um = lowest(&bottoms_um);
            let front = format::front(&header).map_err(refused)?;
            output.file().write_all_at(&front, 0).map_err(io_error)?;
        }
        output.persist().map_err(io_error)?;
        Ok(header)
    }

    fn io_error(&self, source: io::Error) -> WriteError {
        WriteError::Io { path: self.path.clone(), source }
    }

    fn refused(&self, problem: String) -> WriteError {
        WriteError::Refused { path: self.path.clone(), problem }
    }
}

/// Sets where the blend of the joined lattices begins.
fn set_least_fields(file: &BuildFile, header: &mut Header, points: &[[f64; 3]; 2]) -> Result<(), String> {
    let joined = header.joined().unwrap_or(0..0);
    let lattices: Vec<_> = header.bodies[joined.clone()].iter().filter_map(BodyHeader::lattice).collect();
    let found = least_fields(file, joined.clone(), &lattices, points).map_err(|error| error.to_string())??;
    for body in &mut header.bodies[joined] {
        if let BodyHeader::Lattice(Lattice { joint: Joint::Elliptic { least, .. }, .. }) = body {
            *least = found;
        }
    }
    Ok(())
}

/// Finds the lowest solid points of the bodies that are convolutions or clipped, and the bounds of what clips leave. Returns the first clip
/// that leaves nothing.
fn find_bottoms(
    file: &BuildFile,
    bodies: &mut [BodyHeader],
    bottoms_um: &mut [f64],
) -> Result<Option<usize>, BuildFileError> {
    let quantum_um = file.header().quantum_um;
    let joined = file.header().joined().unwrap_or(0..0);
    if let Some(found_um) = lowest_of_joined(file, joined.clone(), bodies)? {
        bottoms_um[joined.clone()].fill(found_um);
    }
    for body in joined.end..bodies.len() {
        let Some((BodyHeader::Lattice(lattice), after)) = bodies[body..].split_first_mut() else { continue };
        if let Some(BodyHeader::Clip(clip)) = after.first_mut() {
            let Some([lowest_um, highest_um]) = range_of_clipped(file, body, lattice, clip)? else {
                return Ok(Some(body + 1));
            };
            // The limits are whole quanta, and the range lies within them.
            clip.bounds.min[2] = (lowest_um / quantum_um).floor() as i32;
            clip.bounds.max[2] = (highest_um / quantum_um).ceil() as i32;
            bottoms_um[body + 1] = lowest_um;
        } else if let Some(found_um) = lowest_of_convolution(file, body..body + 1, &[lattice])? {
            bottoms_um[body] = found_um;
        }
    }
    Ok(None)
}

/// The lowest solid point of the bodies that are joined; `None` if there are none, or they are unions, whose lowest points are known.
fn lowest_of_joined(
    file: &BuildFile,
    joined: Range<usize>,
    bodies: &[BodyHeader],
) -> Result<Option<f64>, BuildFileError> {
    let lattices: Vec<_> = bodies[joined.clone()].iter().filter_map(BodyHeader::lattice).collect();
    lowest_of_convolution(file, joined, &lattices)
}

fn lowest(heights_um: &[f64]) -> f64 {
    heights_um.iter().copied().fold(f64::INFINITY, f64::min)
}
