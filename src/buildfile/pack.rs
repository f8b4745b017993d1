//! From sources of any size and order to one build file.

use std::num::NonZero;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::collect::{Collector, Rules, check_options};
use super::import::Source;
use super::merge::Merge;
use super::model::{Blend, Caps, Header, Placement, Strut};
use super::sort;
use super::writer::{WriteError, Writer, WriterSettings};
use crate::output::{self, Output};

/// Bytes of a strut in a build file: what a large file takes at most in practice.
pub(super) const EXPECTED_STRUT_BYTES: u64 = 10;

/// How to pack.
#[derive(Clone, Debug, PartialEq)]
pub struct PackOptions {
    /// Leave out what is not a lattice instead of refusing it.
    pub lattice_only: bool,
    /// How struts are joined; `None` is what the format of the sources means: union for 3MF, convolution for edge text.
    pub blend: Option<BlendChoice>,
    /// Degrees about x, then y, then z.
    pub rotate_deg: [f64; 3],
    /// Factors, greater than 0, on lengths along x, y and z, after turning. Radii get the mean of least and largest factor,
    /// where that leaves no surface more than 25 µm off the stretched one.
    pub scale: [f64; 3],
    /// Where the part stands.
    pub placement: Placement,
    /// Length of one quantum, micrometres, 0.001 to 1000: coordinates and radii are rounded to whole ones.
    pub quantum_um: f64,
    /// Bytes the out-of-core sort may take.
    pub memory_bytes: u64,
    /// Threads that parse and sort, and as many, up to 4, that compress. The file does not depend on their number.
    pub threads: NonZero<usize>,
}

impl Default for PackOptions {
    /// Taken as it stands, joined as its format means it, in the middle of the plate; 256 MiB of memory, one thread.
    fn default() -> Self {
        Self {
            lattice_only: false,
            blend: None,
            rotate_deg: [0.0; 3],
            scale: [1.0; 3],
            placement: Placement::Centred,
            quantum_um: 1.0,
            memory_bytes: 256 << 20,
            threads: NonZero::<usize>::MIN,
        }
    }
}

/// The blend as it is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BlendChoice {
    /// A convolution surface; where no support R is named it is 1.5 times the largest radius.
    Convolution {
        /// R in millimetres, after scaling.
        support_mm: Option<f64>,
    },
    /// The exact union.
    Union,
}

/// How far packing has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackProgress {
    /// Said before each source whose struts, with those of the sources before it, may not fit memory.
    Space {
        /// Temporary space needed beside the build file, at most; without what the sources before it have taken.
        temporary_bytes: u64,
        /// Space needed for the build file itself, about.
        output_bytes: u64,
        /// Space that is free there.
        free_bytes: u64,
    },
    /// Source bytes read, of all.
    Reading {
        /// Bytes read.
        done: u64,
        /// Bytes in all.
        total: u64,
    },
    /// Bytes of sorted runs joined to longer ones, of all: only where memory is little for so many struts.
    Joining {
        /// Bytes joined.
        done: u64,
        /// Bytes in all.
        total: u64,
    },
    /// Struts written, of all.
    Writing {
        /// Struts written.
        done: u64,
        /// Struts in all.
        total: u64,
    },
}

/// What packing did.
#[derive(Clone, Debug, PartialEq)]
pub struct PackReport {
    /// The finished file's header.
    pub header: Header,
    /// Everything that was left out, merged or not taken as the source says, one sentence each.
    pub notes: Vec<String>,
}

/// Why packing failed. Nothing half-written stays behind.
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// A source cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A source holds what cannot be printed.
    #[error("{place}: {problem}")]
    Input {
        /// File, and line or object.
        place: String,
        /// What was found, what is allowed, and the remedy.
        problem: String,
    },
    /// An option is out of range.
    #[error("{0}")]
    Option(String),
    /// Sorting out of core failed.
    #[error("cannot write beside the build file, in {}: {source}", directory.display())]
    Sort {
        /// Where runs are spilled: beside the build file.
        directory: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The build file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

impl PackError {
    /// An [`PackError::Input`].
    pub(super) fn input(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Input { place: place.into(), problem: problem.into() }
    }
}

/// Joins `inputs` into the build file `output`.
///
/// # Errors
/// [`PackError`] names the file, the place in it, what was found and the remedy.
pub fn pack(
    inputs: &[PathBuf],
    output: &Path,
    options: &PackOptions,
    progress: &mut dyn FnMut(PackProgress),
) -> Result<PackReport, PackError> {
    let directory = output::directory_of(output);
    check_options(options)?;
    let sources = inputs.iter().map(|path| Source::of(path)).collect::<Result<Vec<_>, _>>()?;
    let rules = Rules::new(options, options.blend.map_or_else(|| blend_of(&sources), Ok)?)?;
    // Whether it can be written is told before the sources are read.
    Output::create(output).map_err(|source| WriteError::Io { path: output.into(), source })?;
    let total = inputs.iter().map(|path| check_input(path, output)).sum::<Result<u64, _>>()?;
    let mut collector = Collector::new(&rules, options, directory);
    let mut before = 0;
    for (path, source) in inputs.iter().zip(sources) {
        let mut report = |step| match step {
            PackProgress::Reading { done, .. } => progress(PackProgress::Reading { done: before + done, total }),
            other => progress(other),
        };
        source.import(path, options, &mut collector, &mut report)?;
        before += std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    }
    let collected = collector.finish(inputs)?;
    let sort_error = |source| PackError::Sort { directory: directory.into(), source };
    sort::check_free_space(directory, EXPECTED_STRUT_BYTES * collected.count).map_err(sort_error)?;
    let settings = WriterSettings {
        quantum_um: options.quantum_um,
        blend: collected.blend,
        largest_radius: collected.largest_radius,
        placement: options.placement,
        source_digest: collected.source_digest,
        source_name: source_name(inputs),
    };
    let writer = Writer::with_threads(output, settings, options.threads)?;
    let mut notes = collected.notes;
    let mut report = |done, total| progress(PackProgress::Joining { done, total });
    let sorted = sort::finish(collected.sorters, &mut report).map_err(sort_error)?;
    let mut report = |done| progress(PackProgress::Writing { done, total: collected.count });
    let header = write(sorted, writer, collected.blend, &mut notes, &mut report, &sort_error)?;
    Ok(PackReport { header, notes })
}

/// How struts are joined where nobody says.
///
/// # Errors
/// Where the sources mean different things.
fn blend_of(sources: &[Source]) -> Result<BlendChoice, PackError> {
    let union_count = sources.iter().filter(|source| source.blend() == BlendChoice::Union).count();
    match sources.first() {
        Some(_) if union_count % sources.len() != 0 => Err(PackError::Option(
            "3MF and edge text together: 3MF means the exact union of its beams, edge text a convolution surface; say which with \
             --blend union or --blend convolution"
                .into(),
        )),
        Some(source) => Ok(source.blend()),
        None => Ok(BlendChoice::Union),
    }
}

/// Refuses what cannot be a source of `output`; returns its length.
fn check_input(path: &Path, output: &Path) -> Result<u64, PackError> {
    let metadata = std::fs::metadata(path).map_err(|source| PackError::Read { path: path.into(), source })?;
    if metadata.is_dir() {
        return Err(PackError::input(path.display().to_string(), "it is a directory; name a file to read"));
    }
    if std::fs::metadata(output).is_ok_and(|there| (there.dev(), there.ino()) == (metadata.dev(), metadata.ino())) {
        let problem = "it is both read and written; name another build file with -o";
        return Err(PackError::input(path.display().to_string(), problem));
    }
    Ok(metadata.len())
}

fn write(
    sorted: Merge,
    mut writer: Writer,
    blend: Blend,
    notes: &mut Vec<String>,
    report: &mut dyn FnMut(u64),
    sort_error: &dyn Fn(std::io::Error) -> PackError,
) -> Result<Header, PackError> {
    let (mut last, mut duplicates, mut total) = (None, 0u64, 0);
    for strut in sorted {
        let strut = strut.map_err(sort_error)?;
        if total % (1 << 16) == 0 {
            report(total);
        }
        total += 1;
        // Caps do not tell struts of a convolution apart.
        let counted = if blend == Blend::Union { strut } else { Strut { caps: Caps::default(), ..strut } };
        if last == Some(counted) {
            duplicates += 1;
        } else {
            writer.push(strut)?;
        }
        last = Some(counted);
    }
    report(total);
    if duplicates > 0 {
        notes.push(format!(
            "{duplicates} exact duplicates of struts were merged: counted twice they would print thicker"
        ));
    }
    Ok(writer.finish()?)
}

fn source_name(inputs: &[PathBuf]) -> String {
    let names = inputs.iter().filter_map(|path| path.file_name());
    names.map(|name| name.to_string_lossy()).collect::<Vec<_>>().join(" + ")
}
