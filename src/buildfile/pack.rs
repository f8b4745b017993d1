//! Packs sources of any size and order into one build file. [`buildfile`](crate::buildfile) has an example.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::error::PackError;
use super::import::{Collector, Rules, Source, check_options};
use super::model::{Blend, Caps, Header, Strut};
use super::options::{BlendChoice, PackOptions};
use super::primitive::EXPECTED_STRUT_BYTES;
use super::progress::PackProgress;
use super::sort::{self, Merge};
use super::store::{BodySettings, WriteError, Writer, WriterSettings};
use crate::output::{self, Output};
use crate::text::count_text;

/// Result of packing.
#[derive(Clone, Debug, PartialEq)]
pub struct PackReport {
    /// Header of the finished file.
    pub header: Header,
    /// One sentence for each thing that was left out, merged, or not taken as the source states it.
    pub notes: Vec<String>,
}

/// Packs `inputs` into the build file `output`.
///
/// # Errors
/// [`PackError`] names the file, the place in it, what was found and what to do.
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
    // Fails before the sources are read if the output cannot be written.
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

/// The default blend of the sources.
///
/// # Errors
/// If their defaults differ.
fn blend_of(sources: &[Source]) -> Result<BlendChoice, PackError> {
    let union_count = sources.iter().filter(|source| source.blend() == BlendChoice::Union).count();
    match sources.first() {
        Some(_) if union_count % sources.len() != 0 => Err(PackError::Option(
            "3MF and edge text together: the default of 3MF is the exact union, that of edge text a convolution surface; choose with \
             --blend union or --blend convolution"
                .into(),
        )),
        Some(source) => Ok(source.blend()),
        None => Ok(BlendChoice::Union),
    }
}

/// Refuses a path that cannot be a source of `output`; returns the length of the source.
fn check_input(path: &Path, output: &Path) -> Result<u64, PackError> {
    let metadata = std::fs::metadata(path).map_err(|source| PackError::Read { path: path.into(), source })?;
    if metadata.is_dir() {
        return Err(PackError::input(path.display().to_string(), "it is a directory; name a file to read"));
    }
    if std::fs::metadata(output).is_ok_and(|there| (there.dev(), there.ino()) == (metadata.dev(), metadata.ino())) {
        let problem = "it is both source and output; name another build file with -o";
        return Err(PackError::input(path.display().to_string(), problem));
    }
    Ok(metadata.len())
}

fn write(
    sorted: Merge<Strut>,
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
        // In a convolution, struts that differ only in their caps are duplicates.
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
            "merged {}: a strut that counts twice prints thicker",
            count_text(duplicates, "exact duplicate")
        ));
    }
    Ok(writer.finish()?)
}

fn source_name(inputs: &[PathBuf]) -> String {
    let names = inputs.iter().filter_map(|path| path.file_name());
    names.map(|name| name.to_string_lossy()).collect::<Vec<_>>().join(" + ")
}
