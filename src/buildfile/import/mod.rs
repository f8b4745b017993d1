//! Readers of sources. Each streams its file and hands beams, balls and triangles to the [`Collector`]; `pack` calls them.

mod clips;
mod collect;
mod edge_text;
mod height_map;
mod holes;
mod lane;
mod materials;
mod mesh;
mod meshes;
mod normals;
mod open_edges;
mod points;
mod relief;
mod rules;
mod seams;
mod solid_check;
mod stretch;
mod struts;
mod surface;
mod three_mf;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use sha2::Digest;

use super::error::PackError;
use super::options::{JointChoice, PackOptions};
use super::progress::PackProgress;
pub(super) use clips::CollectedClip;
pub(super) use collect::{CollectedLattice, Collector};
pub(super) use relief::CollectedRelief;
pub(super) use rules::{Rules, check_options};
pub(super) use struts::Struts;
pub(super) use surface::CollectedSurface;

/// Refuses what is no file. A pipe that a source names would keep its reader waiting.
///
/// # Errors
/// If it is none, or not there.
fn check_regular(path: &Path) -> Result<(), PackError> {
    let metadata = std::fs::metadata(path).map_err(|source| PackError::Read { path: path.into(), source })?;
    if metadata.is_file() {
        return Ok(());
    }
    Err(PackError::input(path.display().to_string(), "it is no regular file; name a file to read"))
}

/// Adds the bytes of the file to the digest of the sources.
fn digest(path: &Path, collector: &mut Collector<'_>) -> Result<(), PackError> {
    let error = |source| PackError::Read { path: path.into(), source };
    let mut file = File::open(path).map_err(error)?;
    let (_, digest) = collector.parts();
    let mut buffer = vec![0; 64 << 10];
    loop {
        match file.read(&mut buffer).map_err(error)? {
            0 => return Ok(()),
            count => digest.update(&buffer[..count]),
        }
    }
}

/// Reads the height map that the options name.
///
/// # Errors
/// If it cannot be read.
pub(super) fn open_map(collector: &mut Collector<'_>) -> Result<(), PackError> {
    collector.meshes.open_map()?;
    match collector.meshes.map_path().map(Path::to_path_buf) {
        Some(path) => digest(&path, collector),
        None => Ok(()),
    }
}

/// Imports all sources, of `total` bytes together. `progress` is told of the bytes of all that were read so far.
///
/// # Errors
/// If one of them cannot be read, or what it says cannot be packed.
pub(super) fn import_all(
    inputs: &[PathBuf],
    sources: &[Source],
    options: &PackOptions,
    collector: &mut Collector<'_>,
    total: u64,
    progress: &mut dyn FnMut(PackProgress),
) -> Result<(), PackError> {
    let mut before = 0;
    for (path, source) in inputs.iter().zip(sources) {
        let mut report = |step| match step {
            PackProgress::Reading { done, .. } => progress(PackProgress::Reading { done: before + done, total }),
            other => progress(other),
        };
        source.import(path, options, collector, &mut report)?;
        before += std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    }
    Ok(())
}

/// How many kinds of primitives may come from these sources: struts, flat triangles, triangles with relief, and what is clipped with what
/// clips it.
pub(super) fn kinds(sources: &[Source], options: &PackOptions) -> u64 {
    let any = |has: fn(Source) -> bool| sources.iter().any(|source| has(*source));
    let is_relief = options.relief.applies();
    let kinds = [
        any(|source| source.joint().is_some()),
        any(Source::has_triangles) && !is_relief,
        any(Source::has_triangles) && is_relief || any(Source::has_relief),
        any(Source::has_clips) && !options.lattice_only,
    ];
    kinds.into_iter().map(u64::from).sum::<u64>().max(1)
}

/// The format of a source.
#[derive(Clone, Copy, Debug)]
pub(super) enum Source {
    EdgeText,
    Obj,
    Ply,
    Stl,
    ThreeMf,
}

impl Source {
    /// The format of a file, by its extension.
    ///
    /// # Errors
    /// If the extension is unknown.
    pub(super) fn of(path: &Path) -> Result<Self, PackError> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("3mf") => Ok(Self::ThreeMf),
            Some("obj") => Ok(Self::Obj),
            Some("ply") => Ok(Self::Ply),
            Some("stl") => Ok(Self::Stl),
            Some("txt") => Ok(Self::EdgeText),
            _ => Err(PackError::input(
                path.display().to_string(),
                "unknown kind of file; pack reads .3mf (3MF), .stl (STL), .obj (OBJ), .ply (PLY) and .txt (edge text)",
            )),
        }
    }

    /// The joint that the format means; `None` if it holds no struts.
    pub(super) fn joint(self) -> Option<JointChoice> {
        match self {
            Self::EdgeText => Some(JointChoice::Convolution { support_mm: None }),
            Self::Obj | Self::Ply | Self::Stl => None,
            Self::ThreeMf => Some(JointChoice::Union),
        }
    }

    /// Whether it may hold flat triangles.
    fn has_triangles(self) -> bool {
        matches!(self, Self::Obj | Self::Ply | Self::Stl | Self::ThreeMf)
    }

    /// Whether it may state that triangles are displaced.
    fn has_relief(self) -> bool {
        matches!(self, Self::Obj | Self::ThreeMf)
    }

    /// Whether it may hold lattices that are clipped.
    fn has_clips(self) -> bool {
        matches!(self, Self::ThreeMf)
    }

    /// Reads one source. `progress` counts the bytes of this source.
    ///
    /// # Errors
    /// [`PackError`] names the file and the place in it.
    fn import(
        self,
        path: &Path,
        options: &PackOptions,
        collector: &mut Collector<'_>,
        progress: &mut dyn FnMut(PackProgress),
    ) -> Result<(), PackError> {
        match self {
            Self::EdgeText => edge_text::import(path, collector, progress),
            Self::Obj => mesh::import_obj(path, options.memory_bytes, collector, progress),
            Self::Ply => mesh::import_ply(path, options.memory_bytes, collector, progress),
            Self::Stl => mesh::import_stl(path, collector, progress),
            Self::ThreeMf => three_mf::import(path, options, collector, progress),
        }
    }
}
