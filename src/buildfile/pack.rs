//! From sources of any size and order to one build file.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::error::PackError;
use super::import::{Collector, Rules, Source, check_options};
use super::model::{Blend, Caps, Header, Strut};
use super::options::{BlendChoice, PackOptions};
use super::progress::PackProgress;
use super::sort::{self, Merge};
use super::store::{BodySettings, EXPECTED_STRUT_BYTES, WriteError, Writer, WriterSettings};
use crate::output::{self, Output};
use crate::text::count_text;

/// What packing did.
#[derive(Clone, Debug, PartialEq)]
pub struct PackReport {
    /// The finished file's header.
    pub header: Header,
    /// Everything that was left out, merged or not taken as the source says, one sentence each.
    pub notes: Vec<String>,
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
        placement: options.placement,
        source_digest: collected.source_digest,
        source_name: source_name(inputs),
        bodies: vec![BodySettings::Lattice { blend: collected.blend, largest_radius: collected.largest_radius }],
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
            "merged {}: a strut that counts twice would print thicker",
            count_text(duplicates, "exact duplicate")
        ));
    }
    Ok(writer.finish()?)
}

fn source_name(inputs: &[PathBuf]) -> String {
    let names = inputs.iter().filter_map(|path| path.file_name());
    names.map(|name| name.to_string_lossy()).collect::<Vec<_>>().join(" + ")
}
