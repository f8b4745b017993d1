//! 3MF: core model, and the extensions for production, beam lattices (1.2) and displacement (0.8). The compressed parts of the package are read in two passes and
//! never extracted.
//!
//! In a file, beams and triangles come before the build items that place them. So the first pass (`structure`, `assembly`) finds out where
//! every object is placed, and the second (`lattice`) hands over each beam and triangle once for each place. Only the vertices of one
//! object and the list of objects and components are in memory. `tests/pack_3mf.rs` and `tests/pack_assembly.rs` have examples.

mod assembly;
mod attributes;
mod clipping;
mod displacement;
mod extensions;
mod lattice;
mod materials;
mod package;
mod part_name;
mod resources;
mod space;
mod structure;
mod tags;
mod xml;

use std::io::Cursor;
use std::path::Path;

use glam::DVec3;

use self::clipping::Clipped;
use self::displacement::Map;
use self::lattice::LatticeReader;
use self::package::Package;
use self::structure::Structure;
use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::import::digest;
use crate::buildfile::import::height_map::MapUse;
use crate::buildfile::options::{DisplacementOptions, PackOptions};
use crate::buildfile::progress::PackProgress;
use crate::text::{count_text, plain_line};

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
    let mut package = Package::open(path)?;
    let structure = Structure::read(&mut package, options.memory_bytes)?;
    // What is no package is refused before all of it is read.
    digest(path, collector)?;
    let root = package.place(package.root());
    structure.notes.iter().for_each(|note| collector.note(format!("{root}: {note}")));
    note_left_out(&structure, options, &package, collector);
    if let (Some(DisplacementOptions { map, .. }), false) = (&options.relief.map, options.lattice_only) {
        refuse_other_map(&structure, &package, map)?;
    }
    let mut clipped = Clipped::default();
    if !options.lattice_only {
        clipped = Clipped::find(&structure, &mut package, &mut collector.clips)?;
        collector.clips.expect(clipped.counts);
        collector.expect_triangles(structure.triangle_count(), progress)?;
    }
    collector.expect(structure.strut_count().saturating_sub(clipped.counts[0]), progress)?;
    let maps = if options.lattice_only || !collector.meshes.takes_maps() {
        Vec::new()
    } else {
        read_maps(&structure, options.memory_bytes, &mut package, collector)?
    };
    // One more byte per vertex marks where balls of mode `all` belong.
    let vertex_limit = usize::try_from(options.memory_bytes).unwrap_or(usize::MAX) / (size_of::<DVec3>() + 1);
    let mut reader = LatticeReader {
        structure: &structure,
        collector,
        place: root.clone(),
        part: 0,
        lattice_only: options.lattice_only,
        vertex_limit,
        maps,
        clipped,
        last_mixture: None,
        short_count: 0,
        pointless_count: 0,
    };
    let file_bytes = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let parts = &structure.resources.part_names;
    let stated_bytes = parts.iter().map(|part| package.stated_bytes(part)).sum::<u64>().max(1);
    let mut before = 0;
    package.rewind();
    for (name, part) in parts.iter().zip(0..) {
        let mut report = |bytes: u64| {
            let share = ((before + bytes) as f64 / stated_bytes as f64).min(1.0);
            progress(PackProgress::Reading { done: (share * file_bytes as f64) as u64, total: file_bytes });
        };
        (reader.place, reader.part) = (package.place(name), part);
        let mut xml = package.part(name)?;
        reader.read(&mut xml, &mut report)?;
        before += xml.position_bytes();
    }
    let LatticeReader { short_count, pointless_count, .. } = reader;
    if short_count > 0 {
        collector.note(format!(
            "{root}: left out {} shorter than the lattice's minlength, as 3MF requires",
            count_text(short_count, "beam")
        ));
    }
    if pointless_count > 0 {
        let pointless = count_text(pointless_count, "beam");
        collector.note(format!("{root}: left out {pointless} of no length, from a vertex to itself"));
    }
    Ok(())
}

/// Refuses to displace by `map` an object that has height maps of its own: nobody would expect that one of them is silently left out.
fn refuse_other_map(structure: &Structure, package: &Package<'_>, map: &Path) -> Result<(), PackError> {
    let mut objects = structure.resources.objects.iter().zip(0..);
    let displaced = objects.find(|(object, number)| object.has_displacement && structure.place_count(*number) > 0);
    let (Some((object, _)), Some(own)) = (displaced, structure.displacements.maps.first()) else { return Ok(()) };
    let place = format!("{}: {}", package.place(package.root()), structure.resources.name(object.id));
    let problem = format!(
        "its displacement mesh has the height map {}, and --displacement names {}: leave out --displacement (--height and --offset \
         change what the 3MF states), or export the part without its displacement",
        plain_line(&own.part),
        map.display()
    );
    Err(PackError::input(place, problem))
}

/// Reads the height maps of the displacements, and returns their numbers.
fn read_maps(
    structure: &Structure,
    memory_bytes: u64,
    package: &mut Package<'_>,
    collector: &mut Collector<'_>,
) -> Result<Vec<u16>, PackError> {
    package.rewind();
    let mut numbers = Vec::new();
    for Map { part, channel, tiles, is_nearest } in &structure.displacements.maps {
        let place = package.place(part);
        let bytes = package.bytes(part, memory_bytes)?;
        let usage = MapUse { channel: *channel, tiles: *tiles, is_nearest: *is_nearest, takes_colours: true };
        numbers.push(collector.meshes.map(Cursor::new(bytes), usage, &place)?);
    }
    Ok(numbers)
}

/// Adds notes on everything in the build that `--lattice-only` leaves out.
fn note_left_out(structure: &Structure, options: &PackOptions, package: &Package<'_>, collector: &mut Collector<'_>) {
    if !options.lattice_only {
        return;
    }
    let root = package.place(package.root());
    for (object, number) in structure.resources.objects.iter().zip(0..) {
        if structure.place_count(number) == 0 {
            continue;
        }
        let place = format!("{root}: {}", structure.resources.name(object.id));
        if object.triangle_count > 0 {
            collector.note(format!("{place}: it holds a solid mesh, which was left out"));
        }
        if object.has_displacement {
            collector.note(format!("{place}: it holds a displacement mesh, which was left out"));
        }
        if let Some(clipping) = &object.clipping {
            let clipping = clipping.text();
            collector.note(format!("{place}: {clipping}, which was left out: the whole lattice is printed"));
        }
    }
}
