//! OBJ, millimetres: faces of all objects and groups are one solid. Vertices are read first and stay in memory; faces are read in a second
//! pass. Texture coordinates, normals and materials (`mtl`) count where the surface is displaced or curved. `tests/pack_mesh/obj.rs` and
//! `tests/relief/` have examples.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::DVec3;

use super::mtl;
use super::obj_lines::{Statements, keyed, number, text};
use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::import::digest;
use crate::buildfile::import::relief::Face;
use crate::buildfile::progress::PackProgress;
use crate::text::{plain_line, size_text};

/// How often progress is reported, statements.
const REPORT_EVERY: u64 = 1 << 14;

/// Most material libraries of a file: programs write one.
const MAX_LIBRARIES: usize = 16;

/// Most materials of a file: a part has at most 16 maps.
const MAX_MATERIALS: usize = 4096;

/// Reads one file. `memory_bytes` is what its vertices may take.
///
/// # Errors
/// [`PackError`] names the file and the line or triangle.
pub(in crate::buildfile::import) fn import(
    path: &Path,
    memory_bytes: u64,
    collector: &mut Collector<'_>,
    progress: &mut dyn FnMut(PackProgress),
) -> Result<(), PackError> {
    let name = path.display().to_string();
    let mut vertices = Vertices { memory_bytes, ..Vertices::default() };
    let mut report = |share: f64, total: u64| {
        progress(PackProgress::Reading { done: (share / 2.0 * total as f64) as u64, total });
    };
    each_statement(path, &mut report, |key, rest, _| vertices.statement(key, rest).map_err(Problem::Line))?;
    if vertices.triangle_count == 0 {
        return Err(PackError::input(name, "it has no faces; export the part again as a mesh of triangles"));
    }
    let displacements = mtl::displacements(path, &vertices.libraries, &vertices.materials, collector)?;
    collector.meshes.begin_solid(!displacements.is_empty());
    collector.expect_triangles(vertices.triangle_count, progress)?;
    let mut faces = Faces {
        name: &name,
        vertices: &vertices,
        displacements,
        displacement: None,
        seen: 0,
        before: [0; 3],
        collector,
    };
    let mut report = |share: f64, total: u64| {
        progress(PackProgress::Reading { done: ((1.0 + share) / 2.0 * total as f64) as u64, total });
    };
    each_statement(path, &mut report, |key, rest, line| faces.statement(key, rest, line))?;
    digest(path, collector)?;
    collector.meshes.end_solid(&name)
}

/// Why a statement cannot be taken.
enum Problem {
    /// The text lacks file and line.
    Line(String),
    /// It has its place.
    Whole(PackError),
}

/// Hands every statement to `take`: its key, the rest, and its line. `report` takes the share of the file that has been read, and its length.
fn each_statement(
    path: &Path,
    report: &mut dyn FnMut(f64, u64),
    mut take: impl FnMut(&[u8], &[u8], u64) -> Result<(), Problem>,
) -> Result<(), PackError> {
    let mut statements = Statements::open(path).map_err(|source| PackError::Read { path: path.into(), source })?;
    let total = statements.total_bytes();
    for step in 1_u64.. {
        let taken = match statements.next() {
            Err(problem) => Err(Problem::Line(problem)),
            Ok(None) => break,
            Ok(Some((statement, line))) => {
                let (key, rest) = keyed(statement);
                take(key, rest, line)
            }
        };
        taken.map_err(|problem| match problem {
            Problem::Line(problem) => {
                PackError::input(format!("{}: line {}", path.display(), statements.line()), problem)
            }
            Problem::Whole(error) => error,
        })?;
        if step.is_multiple_of(REPORT_EVERY) {
            report(statements.read_bytes() as f64 / total.max(1) as f64, total);
        }
    }
    Ok(())
}

/// What faces refer to.
#[derive(Default)]
struct Vertices {
    points: Vec<DVec3>,
    /// NaN where the file holds no numbers: most parts do not need them.
    textures: Vec<[f64; 2]>,
    normals: Vec<DVec3>,
    triangle_count: u64,
    /// Names of the material libraries, and of the materials that faces have.
    libraries: Vec<String>,
    materials: BTreeSet<String>,
    /// What all of this may take.
    memory_bytes: u64,
}

impl Vertices {
    fn statement(&mut self, key: &[u8], rest: &[u8]) -> Result<(), String> {
        match key {
            b"v" => self.points.push(point(text(rest)?)?),
            b"vt" => self.textures.push(numbers(rest)),
            b"vn" => self.normals.push(DVec3::from(numbers(rest))),
            b"f" => self.triangle_count += (rest.split(u8::is_ascii_whitespace).count() as u64).saturating_sub(2),
            b"mtllib" if !rest.is_empty() && self.libraries.len() < MAX_LIBRARIES => {
                self.libraries.extend(text(rest).map(str::to_owned));
            }
            b"usemtl" if self.materials.len() < MAX_MATERIALS => self.materials.extend(text(rest).map(str::to_owned)),
            _ => return Ok(()),
        }
        let needed_bytes = self.points.capacity() * size_of::<DVec3>()
            + self.textures.capacity() * size_of::<[f64; 2]>()
            + self.normals.capacity() * size_of::<DVec3>();
        if needed_bytes as u64 > self.memory_bytes {
            return Err(format!(
                "so far, the vertices take {}, and --memory allows {}; give more, or export the part as binary STL, which takes less",
                size_text(needed_bytes as u64),
                size_text(self.memory_bytes)
            ));
        }
        Ok(())
    }
}

/// The position of a vertex.
fn point(rest: &str) -> Result<DVec3, String> {
    let numbers = rest.split_whitespace().map(|word| number(word, "position")).collect::<Result<Vec<_>, _>>()?;
    match numbers[..] {
        // Three more numbers are a colour.
        [x, y, z] | [x, y, z, _, _, _] => Ok(DVec3::new(x, y, z)),
        [_, _, _, 0.0] | [_, _, _, 0.0, _, _, _] => Err("position: its weight (w) is 0; export the part again".into()),
        [x, y, z, w] | [x, y, z, w, _, _, _] => Ok(DVec3::new(x, y, z) / w),
        _ => Err(format!("position: {} numbers instead of 3; export the part again", numbers.len())),
    }
}

/// The first numbers of a statement; NaN for those that are none.
fn numbers<const N: usize>(rest: &[u8]) -> [f64; N] {
    let mut words = text(rest).unwrap_or_default().split_whitespace();
    [(); N].map(|()| words.next().and_then(|word| word.parse().ok()).unwrap_or(f64::NAN))
}

/// Hands the faces of a file to the collector.
struct Faces<'a, 'b> {
    name: &'a str,
    vertices: &'a Vertices,
    /// Of materials.
    displacements: BTreeMap<String, u8>,
    /// Of the current material.
    displacement: Option<u8>,
    /// Triangles so far.
    seen: u64,
    /// Vertices, texture coordinates and normals so far: negative numbers count back from there.
    before: [usize; 3],
    collector: &'a mut Collector<'b>,
}

/// A corner of a face: what it refers to, counted from 0.
#[derive(Clone, Copy)]
struct Reference {
    point: usize,
    texture: Option<usize>,
    normal: Option<usize>,
}

impl Faces<'_, '_> {
    fn statement(&mut self, key: &[u8], rest: &[u8], line: u64) -> Result<(), Problem> {
        match key {
            b"v" => self.before[0] += 1,
            b"vt" => self.before[1] += 1,
            b"vn" => self.before[2] += 1,
            b"f" => return self.face(rest, line),
            b"usemtl" => {
                self.displacement = text(rest).ok().and_then(|material| self.displacements.get(material).copied());
            }
            _ => {}
        }
        Ok(())
    }

    fn face(&mut self, rest: &[u8], line: u64) -> Result<(), Problem> {
        let words = text(rest).map_err(Problem::Line)?.split_whitespace();
        let corners = words.map(|word| self.reference(word)).collect::<Result<Vec<_>, _>>().map_err(Problem::Line)?;
        let [first, rest @ ..] = &corners[..] else { return Ok(()) };
        for pair in rest.windows(2) {
            self.triangle([*first, pair[0], pair[1]], line).map_err(Problem::Whole)?;
        }
        Ok(())
    }

    fn reference(&self, word: &str) -> Result<Reference, String> {
        let mut parts = word.split('/');
        let Vertices { points, textures, normals, .. } = self.vertices;
        let mut next = |what: [&str; 2], before: usize, count: usize| {
            place(parts.next().unwrap_or_default(), word, what, [before, count])
        };
        let point = next(["vertex", "vertices"], self.before[0], points.len())?;
        let point =
            point.ok_or_else(|| format!("`{}` is no number of a vertex; export the part again", plain_line(word)))?;
        if !self.collector.meshes.is_relief() {
            return Ok(Reference { point, texture: None, normal: None });
        }
        let texture = next(["texture coordinate", "texture coordinates"], self.before[1], textures.len())?;
        let normal = next(["normal", "normals"], self.before[2], normals.len())?;
        Ok(Reference { point, texture, normal })
    }

    fn triangle(&mut self, corners: [Reference; 3], line: u64) -> Result<(), PackError> {
        self.seen += 1;
        let Vertices { points, textures, normals, .. } = self.vertices;
        let place = || format!("{}: line {line}, triangle {}", self.name, self.seen);
        let all = |of: fn(&Reference) -> Option<usize>| {
            let [a, b, c] = [of(&corners[0])?, of(&corners[1])?, of(&corners[2])?];
            Some([a, b, c])
        };
        let directions = all(|corner| corner.normal).map(|numbers| numbers.map(|number| normals[number]));
        if directions.is_some_and(|directions| directions.iter().any(|normal| !normal.is_finite())) {
            return Err(PackError::input(place(), "a normal (vn) is no three numbers; export the part again"));
        }
        let face = Face {
            directions: directions.map(|directions| directions.map(|normal| self.collector.meshes.normal(normal))),
            textures: all(|corner| corner.texture).map(|numbers| numbers.map(|number| textures[number])),
            displacement: self.displacement,
            ..Face::flat(corners.map(|corner| points[corner.point]))
        };
        self.collector.meshes.face(&face, &place)
    }
}

/// What a number in a face means, counted from 0: one of all, or that many back from what came before the face. `None` if there is no
/// number.
fn place(part: &str, word: &str, [one, many]: [&str; 2], [before, count]: [usize; 2]) -> Result<Option<usize>, String> {
    if part.is_empty() {
        return Ok(None);
    }
    let number: i64 =
        part.parse().map_err(|_| format!("`{}` is no number of a {one}; export the part again", plain_line(word)))?;
    let from_first =
        usize::try_from(number).ok().and_then(|number| number.checked_sub(1)).filter(|place| *place < count);
    let from_last =
        usize::try_from(number.unsigned_abs()).ok().filter(|_| number < 0).and_then(|back| before.checked_sub(back));
    from_first
        .or(from_last)
        .map(Some)
        .ok_or_else(|| format!("{one} {number}; there are {count} {many}; export the part again"))
}
