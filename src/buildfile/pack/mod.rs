//! Packs sources of any size and order into one build file. [`buildfile`](crate::buildfile) has an example.

mod materials;

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::buildfile::error::PackError;
use crate::buildfile::import::{
    self, CollectedClip, CollectedLattice, CollectedRelief, CollectedSurface, Collector, Rules, Source, check_options,
};
use crate::buildfile::measure;
use crate::buildfile::model::{BodyHeader, Bounds, Caps, Header, Joint, Keeps, Strut};
use crate::buildfile::options::{BlendBegin, JointChoice, PackOptions};
use crate::buildfile::primitive::{EXPECTED_PATCH_BYTES, EXPECTED_STRUT_BYTES, EXPECTED_TRIANGLE_BYTES};
use crate::buildfile::progress::PackProgress;
use crate::buildfile::relief::Relief;
use crate::buildfile::sort;
use crate::buildfile::store::{BodySettings, WriteError, Writer, WriterSettings};
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
    let joint = options.joint.map_or_else(|| joint_of(&sources), Ok)?;
    // Fails before the sources are read if the output cannot be written.
    Output::create(output).map_err(|source| WriteError::Io { path: output.into(), source })?;
    let total = inputs.iter().map(|path| check_input(path, output)).sum::<Result<u64, _>>()?;
    let mut options = options.clone();
    let mut scaled = None;
    if let Some(size_mm) = options.size_mm {
        let factor = measure::factor(inputs, &sources, (&options, joint, size_mm), directory, progress, total)?;
        scaled = Some(format!("scaled by {factor}, so that its longest edge has {size_mm} mm"));
        options.scale = [factor; 3];
    }
    let options = &options;
    let rules = Rules::new(options, joint)?;
    let mut collector = Collector::new(&rules, options, import::kinds(&sources, options), directory);
    import::open_map(&mut collector)?;
    import::import_all(inputs, &sources, options, &mut collector, total, progress)?;
    for path in collector.read_files() {
        check_input(path, output)?;
    }
    let base = collector.bounds();
    let collected = collector.finish(inputs)?;
    let sort_error = |source| PackError::Sort { directory: directory.into(), source };
    let mut notes: Vec<_> = scaled.into_iter().chain(collected.notes).collect();
    let mut bodies: Vec<Body> = collected.lattices.into_iter().map(Body::Lattice).collect();
    for CollectedClip { keeps, place, lattice, surface } in collected.clips {
        bodies.extend([Body::Lattice(lattice), Body::Clip { keeps, place, surface }]);
    }
    bodies.extend(collected.surface.map(Body::Surface));
    bodies.extend(collected.relief.map(Body::Relief));
    let materials = materials::assign(&mut bodies, &rules, options.split)?;
    notes.extend(materials.as_ref().and_then(materials::note));
    sort::check_free_space(directory, bodies.iter().map(Body::expected_bytes).sum()).map_err(sort_error)?;
    let settings = WriterSettings {
        quantum_um: options.quantum_um,
        placement: options.placement,
        source_digest: collected.source_digest,
        source_name: source_name(inputs),
        materials,
        bodies: bodies.iter().map(Body::settings).collect(),
    };
    let mut writing = Writing {
        writer: Writer::with_threads(output, settings, options.threads)?,
        done: 0,
        total: bodies.iter().map(Body::count).sum(),
        progress,
        sort_error: &sort_error,
    };
    if let JointChoice::Elliptic { begins: BlendBegin::Points(points), .. } = joint {
        writing.writer.set_control_points(points.map(|point| rules.quanta(point)));
    }
    let places: Vec<_> = bodies.iter().map(|body| body.place().to_owned()).collect();
    for (number, body) in bodies.into_iter().enumerate() {
        if number > 0 {
            writing.writer.next_body().map_err(|error| explained(error, &places))?;
        }
        writing.body(body, &mut notes)?;
    }
    let header = writing.writer.finish().map_err(|error| explained(error, &places))?;
    notes.extend(header.bodies.iter().filter_map(|body| outgrown(body, base?, options.quantum_um)));
    Ok(PackReport { header, notes })
}

/// A note if a shell reaches beyond `base`, the box around all that was read, on both sides. On one side, that of an open surface may.
fn outgrown(body: &BodyHeader, base: Bounds, quantum_um: f64) -> Option<String> {
    let BodyHeader::Relief(Relief { bounds, shell_um, is_curved: false, maps, .. }) = body else { return None };
    // Bounds are rounded, and hexagons of points reach beyond these.
    let half = shell_um / quantum_um / 2.0;
    let is_beyond = |axis: usize| {
        f64::from(bounds.min[axis]) < f64::from(base.min[axis]) - half
            && f64::from(bounds.max[axis]) > f64::from(base.max[axis]) + half
    };
    (*shell_um > 0.0 && maps.is_empty() && (0..3).any(is_beyond)).then(|| {
        format!(
            "the shell of {} mm comes out on the other side: it is thicker than the part, or the surface is inside out. Look at the layers \
             with `layerctl slice`",
            shell_um / 1000.0
        )
    })
}

/// The error of a writer, which names bodies by number; `places` are those of their sources.
fn explained(error: WriteError, places: &[String]) -> PackError {
    match error {
        WriteError::NothingLeft { body, .. } => {
            let problem =
                "its clipping mesh leaves nothing of its lattice; is it the right mesh, and the right clippingmode?";
            PackError::input(&places[body], problem)
        }
        error => error.into(),
    }
}

/// A body that is to be written.
enum Body {
    Lattice(CollectedLattice),
    Surface(CollectedSurface),
    Relief(CollectedRelief),
    /// What clips the lattice before it, which stands at `place` of its source.
    Clip {
        keeps: Keeps,
        place: String,
        surface: CollectedSurface,
    },
}

impl Body {
    fn settings(&self) -> BodySettings {
        match self {
            Self::Lattice(lattice) => {
                BodySettings::Lattice { joint: lattice.joint, largest_radius: lattice.largest_radius }
            }
            Self::Surface(_) => BodySettings::Surface,
            Self::Relief(relief) => BodySettings::Relief(relief.settings.clone()),
            Self::Clip { keeps, .. } => BodySettings::Clip { keeps: *keeps },
        }
    }

    /// Number of primitives.
    fn count(&self) -> u64 {
        match self {
            Self::Lattice(lattice) => lattice.count,
            Self::Surface(surface) | Self::Clip { surface, .. } => surface.count,
            Self::Relief(relief) => relief.patches.len() as u64,
        }
    }

    fn expected_bytes(&self) -> u64 {
        self.count()
            * match self {
                Self::Lattice(_) => EXPECTED_STRUT_BYTES,
                Self::Surface(_) | Self::Clip { .. } => EXPECTED_TRIANGLE_BYTES,
                Self::Relief(_) => EXPECTED_PATCH_BYTES,
            }
    }

    /// What errors of a clip name; nothing for others.
    fn place(&self) -> &str {
        if let Self::Clip { place, .. } = self { place } else { "" }
    }
}

/// The default joint of the sources.
///
/// # Errors
/// If their defaults differ.
fn joint_of(sources: &[Source]) -> Result<JointChoice, PackError> {
    let joints: Vec<_> = sources.iter().filter_map(|source| source.joint()).collect();
    match joints.first() {
        Some(first) if joints.iter().any(|joint| joint != first) => Err(PackError::Option(
            "3MF and edge text together: the default of 3MF is the exact union, that of edge text a convolution surface; choose with \
             --joint union or --joint convolution"
                .into(),
        )),
        Some(joint) => Ok(*joint),
        None => Ok(JointChoice::Union),
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
    fn body(&mut self, body: Body, notes: &mut Vec<String>) -> Result<(), PackError> {
        match body {
            Body::Lattice(lattice) => self.lattice(lattice, notes),
            Body::Surface(surface) | Body::Clip { surface, .. } => self.surface(surface),
            Body::Relief(relief) => self.relief(relief),
        }
    }

    /// Writes the struts in order, each once.
    fn lattice(&mut self, lattice: CollectedLattice, notes: &mut Vec<String>) -> Result<(), PackError> {
        let mut report = |done, total| (self.progress)(PackProgress::Joining { done, total });
        let sorted = lattice.struts.sorted(&mut report).map_err(self.sort_error)?;
        let (mut last, mut duplicates) = (None, 0u64);
        for strut in sorted {
            let strut = strut.map_err(self.sort_error)?;
            self.step();
            // In a convolution, struts that differ only in their caps are duplicates.
            let counted = if lattice.joint == Joint::Union { strut } else { Strut { caps: Caps::default(), ..strut } };
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

    /// Writes the patches, which are in order.
    fn relief(&mut self, relief: CollectedRelief) -> Result<(), PackError> {
        for patch in relief.patches {
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
