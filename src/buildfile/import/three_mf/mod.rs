//! 3MF: core model and beam lattice extension 1.2, in two passes over the compressed model, which is never extracted.
//!
//! Beams come before the build items that place them. So the first pass learns where every object stands, and the second
//! hands over each beam once for each place; in memory are one object's vertices and the list of objects.

mod lattice;
mod package;
mod structure;
mod xml;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use glam::DVec3;
use sha2::Digest;

use self::lattice::LatticeReader;
use self::package::Package;
use self::structure::{Structure, object_name};
use crate::buildfile::collect::Collector;
use crate::buildfile::pack::{PackError, PackOptions, PackProgress};

/// Reads one package.
///
/// # Errors
/// [`PackError`] names part, object and beam.
pub(super) fn import(
    path: &Path,
    options: &PackOptions,
    collector: &mut Collector<'_>,
    progress: &mut dyn FnMut(PackProgress),
) -> Result<(), PackError> {
    digest(path, collector)?;
    let mut package = Package::open(path)?;
    let place = package.place();
    let structure = Structure::read(&mut package.model()?).map_err(|problem| PackError::input(&place, problem))?;
    check_left_out(&structure, options, &place, collector)?;
    collector.expect(structure.strut_count(), progress)?;
    // One byte a vertex marks where balls of mode `all` belong.
    let vertex_limit = usize::try_from(options.memory_bytes).unwrap_or(usize::MAX) / (size_of::<DVec3>() + 1);
    let mut reader =
        LatticeReader { structure: &structure, collector, place: place.clone(), vertex_limit, short_count: 0 };
    let file_bytes = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let stated_bytes = package.stated_model_bytes();
    let mut report = |bytes: u64| {
        let share = (bytes as f64 / stated_bytes as f64).min(1.0);
        progress(PackProgress::Reading { done: (share * file_bytes as f64) as u64, total: file_bytes });
    };
    reader.read(&mut package.model()?, &mut report)?;
    let short_count = reader.short_count;
    if short_count > 0 {
        collector.note(format!(
            "{place}: {short_count} beams shorter than their lattice's minlength were left out, as 3MF asks"
        ));
    }
    Ok(())
}

/// Takes the packed bytes into the sources' digest.
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

/// Refuses, or notes, what stands in the build and is no lattice.
fn check_left_out(
    structure: &Structure,
    options: &PackOptions,
    place: &str,
    collector: &mut Collector<'_>,
) -> Result<(), PackError> {
    let mut placed: Vec<_> = structure.objects.iter().filter(|(_, object)| !object.placements.is_empty()).collect();
    placed.sort_unstable_by_key(|(id, _)| **id);
    for (id, object) in placed {
        let mesh = object.has_triangles.then(|| "it holds a solid mesh".to_owned());
        let displaced = object.has_displacement.then(|| "it holds a displacement mesh".to_owned());
        for what in mesh.into_iter().chain(displaced).chain(object.clipping.clone()) {
            let object = format!("{place}: {}", object_name(*id, &object.name));
            if !options.lattice_only {
                let problem = format!("{what}, which is not printed yet; --lattice-only leaves it out");
                return Err(PackError::input(object, problem));
            }
            collector.note(format!("{object}: {what}; it was left out"));
        }
    }
    Ok(())
}
