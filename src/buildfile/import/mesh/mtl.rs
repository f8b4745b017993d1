//! Height maps of materials (MTL): `disp`, or `bump` if there is none. `obj` reads faces that use them.

use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::obj_lines::{Statements, keyed, number, text};
use crate::buildfile::error::PackError;
use crate::buildfile::import::check_regular;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::import::height_map::{Channel, MapUse};
use crate::buildfile::relief::Tile;
use crate::text::plain_line;

/// The map of a material.
#[derive(Clone, Debug, PartialEq)]
struct Statement {
    file: String,
    /// `-bm`: what the map is multiplied by, in the unit of the part.
    multiplier: f64,
    /// `-mm`: what is added to it before, and what it is multiplied by.
    base: f64,
    gain: f64,
    /// `-clamp on`.
    is_clamped: bool,
    channel: Channel,
    /// Whether it is `disp`, not `bump`.
    is_displacement: bool,
}

/// The displacements of materials in the libraries of the OBJ file `obj`. There are none if the options name a map, or a height of 0.
///
/// # Errors
/// If a library or a map cannot be read.
pub(super) fn displacements(
    obj: &Path,
    libraries: &[String],
    used: &BTreeSet<String>,
    collector: &mut Collector<'_>,
) -> Result<BTreeMap<String, u8>, PackError> {
    let mut displacements = BTreeMap::new();
    if !collector.meshes.takes_maps() {
        return Ok(displacements);
    }
    // Materials that no library defines. They are of interest if libraries have maps, and all libraries are there.
    let mut missing: BTreeSet<_> = used.iter().map(String::as_str).collect();
    let (mut has_maps, mut all_there) = (false, !libraries.is_empty());
    for name in libraries {
        let path = beside(obj, name);
        let opened = check_regular(&path)
            .and_then(|()| Statements::open(&path).map_err(|source| PackError::Read { path: path.clone(), source }));
        let statements = match opened {
            Ok(statements) => statements,
            Err(PackError::Read { source, .. }) if source.kind() == ErrorKind::NotFound => {
                let path = path.display();
                collector
                    .note(format!("{}: there is no {path}; height maps of its materials are left out", obj.display()));
                all_there = false;
                continue;
            }
            Err(error) => return Err(error),
        };
        collector.meshes.reads_library(&path);
        let read = materials(statements, &path, used)?;
        missing.retain(|material| !read.names.contains(*material));
        has_maps |= read.has_maps;
        for (material, statement) in read.maps {
            let number = match displacement(&path, &material, &statement, collector) {
                // Programs write `bump` for shading, of any kind of picture.
                Err(error) if !statement.is_displacement => {
                    collector.note(format!("{error}; this `bump` is left out"));
                    continue;
                }
                number => number?,
            };
            displacements.insert(material, number);
        }
    }
    if all_there && has_maps && !missing.is_empty() {
        let names: Vec<_> = missing.into_iter().take(MAX_NAMED).map(plain_line).collect();
        collector.note(format!(
            "{}: no material library defines {}; the faces that use it are not displaced",
            obj.display(),
            names.join(", ")
        ));
    }
    Ok(displacements)
}

/// A file that another file names.
fn beside(path: &Path, name: &str) -> PathBuf {
    // Programs on Windows write its separators.
    path.parent().unwrap_or(Path::new("")).join(name.replace('\\', "/"))
}

/// Adds the displacement of a material.
fn displacement(
    library: &Path,
    material: &str,
    statement: &Statement,
    collector: &mut Collector<'_>,
) -> Result<u8, PackError> {
    let Statement { file, multiplier, base, gain, is_clamped, channel, is_displacement } = statement;
    let tile = if *is_clamped { Tile::Clamp } else { Tile::Wrap };
    let path = beside(library, file);
    // Programs name maps of normals by `bump`, too.
    let usage = MapUse { takes_colours: *is_displacement, ..MapUse::of(*channel, tile) };
    let map = collector.meshes.map_of(&path, usage)?;
    let [low_mm, high_mm] =
        [multiplier * base, multiplier * (base + gain)].map(|length| collector.meshes.scaled(length));
    let [low_mm, high_mm] = collector.meshes.height_range([low_mm, high_mm]);
    collector.note(format!(
        "material {}: displaced by {} from {low_mm} to {high_mm} mm; change it with --height and --offset, leave it out with --height 0",
        plain_line(material),
        path.display()
    ));
    collector.meshes.displacement(map, [low_mm, high_mm], &path.display().to_string())
}

/// Most missing materials that a note names.
const MAX_NAMED: usize = 5;

/// What a library says of the materials in use.
#[derive(Default)]
struct Materials {
    names: BTreeSet<String>,
    /// Of those that have one.
    maps: BTreeMap<String, Statement>,
    /// Whether any material of the library has a map.
    has_maps: bool,
}

/// Reads what a library says of the materials in use.
fn materials(mut statements: Statements, path: &Path, used: &BTreeSet<String>) -> Result<Materials, PackError> {
    let mut materials = Materials::default();
    let mut material = String::new();
    loop {
        let parsed = match statements.next() {
            Ok(None) => return Ok(materials),
            Ok(Some((statement, _))) => {
                let (key, rest) = keyed(statement);
                parse(&key.to_ascii_lowercase(), rest)
            }
            Err(problem) => Err(problem),
        };
        match parsed {
            Ok(Line::Material(name)) => {
                if used.contains(&name) {
                    materials.names.insert(name.clone());
                }
                material = name;
            }
            Ok(Line::Map(map)) => {
                materials.has_maps = true;
                let is_better = |there: &Statement| map.is_displacement && !there.is_displacement;
                if used.contains(&material) && materials.maps.get(&material).is_none_or(is_better) {
                    materials.maps.insert(material.clone(), map);
                }
            }
            Ok(Line::Other) => {}
            Err(problem) => {
                return Err(PackError::input(format!("{}: line {}", path.display(), statements.line()), problem));
            }
        }
    }
}

/// What a statement of a library says.
enum Line {
    Material(String),
    Map(Statement),
    Other,
}

fn parse(key: &[u8], rest: &[u8]) -> Result<Line, String> {
    Ok(match key {
        b"newmtl" => Line::Material(text(rest)?.to_owned()),
        b"disp" | b"map_disp" => Line::Map(map(text(rest)?, true)?),
        b"bump" | b"map_bump" => Line::Map(map(text(rest)?, false)?),
        _ => Line::Other,
    })
}

/// A map with its options, which stand before or after the name of its file.
fn map(rest: &str, is_displacement: bool) -> Result<Statement, String> {
    let mut map = Statement {
        file: String::new(),
        multiplier: 1.0,
        base: 0.0,
        gain: 1.0,
        is_clamped: false,
        channel: Channel::default(),
        is_displacement,
    };
    let mut words = rest.split_whitespace().peekable();
    while let Some(word) = words.next() {
        let mut next = |what: &str| number(words.next().unwrap_or_default(), what);
        match word {
            "-bm" => map.multiplier = next("-bm")?,
            "-mm" => (map.base, map.gain) = (next("-mm")?, next("-mm")?),
            "-clamp" => map.is_clamped = words.next() == Some("on"),
            "-imfchan" => {
                map.channel = match words.next() {
                    Some("r") => Channel::Red,
                    Some("b") => Channel::Blue,
                    Some("m") => Channel::Alpha,
                    _ => Channel::Green,
                }
            }
            "-blendu" | "-blendv" | "-cc" | "-boost" | "-texres" | "-type" => drop(words.next()),
            // One to three numbers: a map that is moved or scaled would lie elsewhere.
            "-o" | "-s" | "-t" => {
                let plain = if word == "-s" { 1.0 } else { 0.0 };
                while let Some(value) = words.peek().and_then(|word| word.parse::<f64>().ok()) {
                    if value != plain {
                        return Err(format!(
                            "{word} {value} moves the map; apply it to the texture coordinates and leave it out"
                        ));
                    }
                    words.next();
                }
            }
            name => {
                map.file += if map.file.is_empty() { "" } else { " " };
                map.file += name;
            }
        }
    }
    if map.file.is_empty() { Err("a map without a file; name one or delete the line".into()) } else { Ok(map) }
}
