//! Packs sources of any size and order into one build file. [`buildfile`](crate::buildfile) has an example.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::error::PackError;
use super::import::{
    self, CollectedLattice, CollectedRelief, CollectedSurface, Collector, Rules, Source, check_options,
};
use super::model::{Blend, Caps, Header, Strut};
use super::options::{BlendChoice, PackOptions};
use super::primitive::{EXPECTED_PATCH_BYTES, EXPECTED_STRUT_BYTES, EXPECTED_TRIANGLE_BYTES};
use super::progress::PackProgress;
use super::sort;
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
    let mut collector = Collector::new(&rules, options, import::kinds(&sources, options), directory);
    import::open_map(&mut collector)?;
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
    let mut notes = collected.notes;
    let (lattice, surface, relief) = (collected.lattice, collected.surface, collected.relief);
    let counts = [
        lattice.as_ref().map_or(0, |lattice| lattice.count),
        surface.as_ref().map_or(0, |surface| surface.count),
        relief.as_ref().map_or(0, |relief| relief.count),
    ];
    let expected_bytes = [EXPECTED_STRUT_BYTES, EXPECTED_TRIANGLE_BYTES, EXPECTED_PATCH_BYTES];
    let output_bytes = counts.iter().zip(expected_bytes).map(|(count, bytes)| count * bytes).sum();
    sort::check_free_space(directory, output_bytes).map_err(sort_error)?;
    let of_lattice = lattice
        .as_ref()
        .map(|lattice| BodySettings::Lattice { blend: lattice.blend, largest_radius: lattice.largest_radius });
    let of_surface = surface.as_ref().map(|_| BodySettings::Surface);
    let of_relief = relief.as_ref().map(|relief| BodySettings::Relief(relief.settings.clone()));
    let settings = WriterSettings {
        quantum_um: options.quantum_um,
        placement: options.placement,
        source_digest: collected.source_digest,
        source_name: source_name(inputs),
        bodies: [of_lattice, of_surface, of_relief].into_iter().flatten().collect(),
    };
    let mut writing = Writing {
        writer: Writer::with_threads(output, settings, options.threads)?,
        done: 0,
        total: counts.iter().sum(),
        progress,
        sort_error: &sort_error,
    };
    let mut has_body = lattice.is_some();
    if let Some(lattice) = lattice {
        writing.lattice(lattice, &mut notes)?;
    }
    if let Some(surface) = surface {
        if std::mem::replace(&mut has_body, true) {
            writing.writer.next_body()?;
        }
        writing.surface(surface)?;
    }
    if let Some(relief) = relief {
        if has_body {
            writing.writer.next_body()?;
        }
        writing.relief(relief)?;
    }
    Ok(PackReport { header: writing.writer.finish()?, notes })
}

/// The default blend of the sources.
///
/// # Errors
/// If their defaults differ.
fn blend_of(sources: &[Source]) -> Result<BlendChoice, PackError> {
    let blends: Vec<_> = sources.iter().filter_map(|source| source.blend()).collect();
    match blends.first() {
        Some(first) if blends.iter().any(|blend| blend != first) => Err(PackError::Option(
            "3MF and edge text together: the default of 3MF is the exact union, that of edge text a convolution surface; choose with \
             --blend union or --blend convolution"
                .into(),
        )),
        Some(blend) => Ok(*blend),
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

/// A file that is being written, body by body.
struct Writing<'a> {
    writer: Writer,
    /// Primitives written, of so many.
    done: u64,
    total: u64,
    progress: &'a mut dyn FnMut(PackProgress),
    sort_error: &'a dyn Fn(std::io::Error) -> PackError,
}

impl Writing<'_> {
    /// Writes the struts in order, each once.
    fn lattice(&mut self, lattice: CollectedLattice, notes: &mut Vec<String>) -> Result<(), PackError> {
        let mut report = |done, total| (self.progress)(PackProgress::Joining { done, total });
        let sorted = sort::finish(lattice.sorters, &mut report).map_err(self.sort_error)?;
        let (mut last, mut duplicates) = (None, 0u64);
        for strut in sorted {
            let strut = strut.map_err(self.sort_error)?;
            self.step();
            // In a convolution, struts that differ only in their caps are duplicates.
            let counted = if lattice.blend == Blend::Union { strut } else { Strut { caps: Caps::default(), ..strut } };
            if last == Some(counted) {
                duplicates += 1;
            } else {
                self.writer.push(strut)?;
            }
            last = Some(counted);
        }
        if duplicates > 0 {
            notes.push(format!(
                "merged {}: a strut that counts twice prints thicker",
                count_text(duplicates, "exact duplicate")
            ));
        }
        Ok(())
    }

    /// Writes the triangles in order. One that is there twice counts twice, as the winding number demands.
    fn surface(&mut self, surface: CollectedSurface) -> Result<(), PackError> {
        let mut report = |done, total| (self.progress)(PackProgress::Joining { done, total });
        let sorted = sort::finish(vec![surface.sorter], &mut report).map_err(self.sort_error)?;
        for triangle in sorted {
            let triangle = triangle.map_err(self.sort_error)?;
            self.step();
            self.writer.push_triangle(triangle)?;
        }
        Ok(())
    }

    /// Writes the patches in order.
    fn relief(&mut self, relief: CollectedRelief) -> Result<(), PackError> {
        let mut report = |done, total| (self.progress)(PackProgress::Joining { done, total });
        for patch in sort::finish(vec![relief.sorter], &mut report).map_err(self.sort_error)? {
            let patch = patch.map_err(self.sort_error)?;
            self.step();
            self.writer.push_patch(patch)?;
        }
        Ok(())
    }

    fn step(&mut self) {
        self.done += 1;
        if self.done.is_multiple_of(1 << 16) || self.done == self.total {
            (self.progress)(PackProgress::Writing { done: self.done, total: self.total });
        }
    }
}

fn source_name(inputs: &[PathBuf]) -> String {
    let names = inputs.iter().filter_map(|path| path.file_name());
    names.map(|name| name.to_string_lossy()).collect::<Vec<_>>().join(" + ")
}
