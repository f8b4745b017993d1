//! From sources of any size and order to one build file.

use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use super::collect::Collector;
use super::import;
use super::model::{Header, Placement};
use super::sort::{self, Sorted};
use super::writer::{WriteError, Writer, WriterSettings};

/// Length of one quantum in imported files: a pixel's fiftieth to eightieth on the finest projectors.
const QUANTUM_UM: f64 = 1.0;

/// How to pack.
#[derive(Clone, Debug, PartialEq)]
pub struct PackOptions {
    /// Leave out what is not a lattice instead of refusing it.
    pub lattice_only: bool,
    /// How struts are joined.
    pub blend: BlendChoice,
    /// Degrees about x, then y, then z.
    pub rotate_deg: [f64; 3],
    /// Factor, greater than 0, on lengths and radii.
    pub scale: f64,
    /// Where the part stands.
    pub placement: Placement,
    /// Bytes the out-of-core sort may take.
    pub memory_bytes: u64,
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
    /// Source bytes read, of all.
    Reading {
        /// Bytes read.
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
    let directory = match output.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    for path in inputs {
        let metadata = std::fs::metadata(path).map_err(|source| PackError::Read { path: path.clone(), source })?;
        if metadata.is_dir() {
            return Err(PackError::input(path.display().to_string(), "it is a directory; name a file to read"));
        }
        if std::fs::metadata(output).is_ok_and(|there| (there.dev(), there.ino()) == (metadata.dev(), metadata.ino())) {
            let problem = "it is both read and written; name another build file with -o";
            return Err(PackError::input(path.display().to_string(), problem));
        }
    }
    let importers = inputs.iter().map(|path| import::importer(path)).collect::<Result<Vec<_>, _>>()?;
    let (source_digest, total) = digest(inputs)?;
    let mut collector = Collector::new(options, QUANTUM_UM, directory)?;
    let mut before = 0;
    for (path, import) in inputs.iter().zip(importers) {
        let mut report = |done| progress(PackProgress::Reading { done: before + done, total });
        import(path, options, &mut collector, &mut report)?;
        before += std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    }
    let collected = collector.finish(inputs)?;
    let sort_error = |source| PackError::Sort { directory: directory.into(), source };
    // Ten bytes a strut is what a large file takes at most in practice.
    sort::check_free_space(directory, 10 * collected.count).map_err(sort_error)?;
    let settings = WriterSettings {
        quantum_um: QUANTUM_UM,
        blend: collected.blend,
        largest_radius: collected.largest_radius,
        placement: options.placement,
        source_digest,
        source_name: source_name(inputs),
    };
    let writer = Writer::create(output, settings)?;
    let mut notes = collected.notes;
    let sorted = collected.sorter.finish().map_err(sort_error)?;
    let mut report = |done| progress(PackProgress::Writing { done, total: collected.count });
    let header = write(sorted, writer, &mut notes, &mut report, &sort_error)?;
    Ok(PackReport { header, notes })
}

fn write(
    sorted: Sorted,
    mut writer: Writer,
    notes: &mut Vec<String>,
    report: &mut dyn FnMut(u64),
    sort_error: &dyn Fn(std::io::Error) -> PackError,
) -> Result<Header, PackError> {
    let (mut last, mut duplicates) = (None, 0u64);
    for (number, strut) in sorted.enumerate() {
        let strut = strut.map_err(sort_error)?;
        if last == Some(strut) {
            duplicates += 1;
        } else {
            writer.push(strut)?;
        }
        last = Some(strut);
        if number.is_multiple_of(1 << 16) {
            report(number as u64);
        }
    }
    if duplicates > 0 {
        notes.push(format!(
            "{duplicates} exact duplicates of struts were merged: counted twice they would print thicker"
        ));
    }
    Ok(writer.finish()?)
}

/// SHA-256 over all inputs' bytes and their length together.
fn digest(inputs: &[PathBuf]) -> Result<([u8; 32], u64), PackError> {
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 64 << 10];
    let mut total = 0;
    for path in inputs {
        let error = |source| PackError::Read { path: path.clone(), source };
        let mut file = std::fs::File::open(path).map_err(error)?;
        loop {
            let count = file.read(&mut buffer).map_err(error)?;
            if count == 0 {
                break;
            }
            hasher.update(&buffer[..count]);
            total += count as u64;
        }
    }
    Ok((hasher.finalize().into(), total))
}

fn source_name(inputs: &[PathBuf]) -> String {
    let names = inputs.iter().filter_map(|path| path.file_name());
    names.map(|name| name.to_string_lossy()).collect::<Vec<_>>().join(" + ")
}
