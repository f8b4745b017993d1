//! PLY, text and binary, millimetres: vertices `x`, `y`, `z`, and faces as lists of their numbers; or a cloud of points with normals.
//! Normals and texture coordinates count where the surface has relief. The library reads one element after the
//! other; only the vertices stay in memory. `tests/pack_mesh/ply.rs` has examples.

use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use glam::DVec3;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult};

use super::ply_head::{self, Announced};
use super::source::{MAX_LINE_BYTES, Source};
use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::import::digest;
use crate::buildfile::import::points;
use crate::buildfile::import::relief::Face;
use crate::buildfile::progress::PackProgress;
use crate::text::{plain_line, size_text};

/// Longest head, bytes: even one with many comments is shorter. The library holds it in memory.
const MAX_HEAD_BYTES: u64 = 64 << 10;

/// Most of a message of the library that is shown, characters: it quotes whole lines.
const MAX_QUOTE_CHARS: usize = 160;

/// How often progress is reported, elements.
const REPORT_EVERY: u64 = 1 << 14;

/// Reads one file. `memory_bytes` is what its vertices may take.
///
/// # Errors
/// [`PackError`] names the file and the line or element.
pub(in crate::buildfile::import) fn import(
    path: &Path,
    memory_bytes: u64,
    collector: &mut Collector<'_>,
    progress: &mut dyn FnMut(PackProgress),
) -> Result<(), PackError> {
    let name = path.display().to_string();
    let read_error = |source| PackError::Read { path: path.into(), source };
    let wrong = |problem: String| PackError::input(&name, problem);
    let mut source = Source::open(path).map_err(read_error)?;
    let total = source.length;
    let head = source.head(MAX_HEAD_BYTES).map_err(read_error)?;
    let mut reader = Reader::new(&head[..]);
    let header = Parser::<Element>::new()
        .read_header(&mut reader)
        .map_err(|error| wrong(format!("{}; is it PLY? Export the part again", said(&error))))?;
    let head_bytes = (head.len() - reader.get_ref().len()) as u64;
    let body_bytes = total - head_bytes;
    let announced = ply_head::check(&header, body_bytes).map_err(wrong)?;
    let is_cloud = !announced.has_faces;
    if is_cloud {
        check_cloud(&announced, collector).map_err(wrong)?;
    }
    let mut vertices = Vertices::new(&announced, collector.meshes.is_relief());
    let needed_bytes = announced.vertices.saturating_mul(vertices.bytes_each(is_cloud));
    if needed_bytes > memory_bytes {
        let [needed, allowed] = [needed_bytes, memory_bytes].map(size_text);
        let problem =
            format!("its {} vertices take {needed}, and --memory allows {allowed}; give more", announced.vertices);
        return Err(wrong(problem));
    }
    vertices.reserve(announced.vertices as usize);
    // Each triangle of a fan takes one more corner.
    let triangles = if is_cloud {
        points::triangle_count(announced.vertices)
    } else {
        body_bytes / ply_head::corner_bytes(&header)
    };
    collector.expect_triangles(triangles, progress)?;
    source.is_text = header.encoding == Encoding::Ascii;
    source.seek(SeekFrom::Start(head_bytes)).map_err(read_error)?;
    let elements = Elements {
        reader: BufReader::with_capacity(64 << 10, source),
        encoding: header.encoding,
        parser: Parser::new(),
        line: String::new(),
        line_number: reader.line() as u64 - 1,
    };
    read(elements, &header, &name, vertices, collector, progress)?;
    digest(path, collector)?;
    collector.meshes.end_solid(&name)
}

/// Reads all elements.
fn read(
    mut elements: Elements,
    header: &Header,
    name: &str,
    mut vertices: Vertices,
    collector: &mut Collector<'_>,
    progress: &mut dyn FnMut(PackProgress),
) -> Result<(), PackError> {
    let total = elements.reader.get_ref().length;
    for definition in header.elements.values() {
        for number in 1..=definition.count as u64 {
            let place = || format!("{name}: {} {number}", definition.name);
            let element = elements.next(definition).map_err(|problem| {
                PackError::input(place(), format!("{problem}; is the file cut short or damaged? Export the part again"))
            })?;
            if definition.name == ply_head::VERTEX {
                vertices.push(&element);
            } else if definition.name == ply_head::FACE {
                add_face(&element.corners, &vertices, &place, collector)?;
            }
            if number.is_multiple_of(REPORT_EVERY) {
                let done = elements.reader.get_mut().stream_position().unwrap_or(total);
                progress(PackProgress::Reading { done, total });
            }
        }
    }
    if vertices.is_cloud { add_discs(&vertices, name, collector) } else { Ok(()) }
}

/// Refuses points that cannot become a surface.
fn check_cloud(announced: &Announced, collector: &Collector<'_>) -> Result<(), String> {
    if !collector.meshes.is_shell() {
        return Err("it has no faces: it is a cloud of points, or made of strips. A cloud with normals prints with --shell MM; export \
                    other parts as a mesh of triangles"
            .into());
    }
    if !announced.has_normals {
        return Err("it is a cloud of points, but they have no normals (nx, ny, nz), which say where the outside is; let the program \
                    that made it compute them"
            .into());
    }
    Ok(())
}

/// Adds a disc for each point.
fn add_discs(vertices: &Vertices, name: &str, collector: &mut Collector<'_>) -> Result<(), PackError> {
    for (number, normal) in vertices.normals.iter().enumerate() {
        // False if it is NaN.
        if !(normal.is_finite() && normal.length() > 0.0) {
            let problem = "its normal has no direction; let the program that made the cloud compute it";
            return Err(PackError::input(format!("{name}: vertex {}", number + 1), problem));
        }
    }
    points::discs(&vertices.points, &vertices.normals, |corners, number| {
        let directions = Some([collector.meshes.normal(vertices.normals[number]); 3]);
        let place = || format!("{name}: vertex {}", number + 1);
        collector.meshes.face(&Face { directions, ..Face::flat(corners) }, &place)
    })
}

/// What faces refer to.
struct Vertices {
    points: Vec<DVec3>,
    /// As many, or none.
    normals: Vec<DVec3>,
    textures: Vec<[f64; 2]>,
    has_normals: bool,
    has_textures: bool,
    is_cloud: bool,
}

impl Vertices {
    fn new(announced: &Announced, is_relief: bool) -> Self {
        Self {
            points: Vec::new(),
            normals: Vec::new(),
            textures: Vec::new(),
            has_normals: announced.has_normals && is_relief,
            has_textures: announced.has_textures && is_relief,
            is_cloud: !announced.has_faces,
        }
    }

    /// Memory of a vertex, bytes.
    fn bytes_each(&self, is_cloud: bool) -> u64 {
        let normal = if self.has_normals { size_of::<DVec3>() } else { 0 };
        let texture = if self.has_textures { size_of::<[f64; 2]>() } else { 0 };
        let disc = if is_cloud { points::BYTES_PER_POINT } else { 0 };
        (size_of::<DVec3>() + normal + texture) as u64 + disc
    }

    /// Takes the memory of so many vertices, and no more.
    fn reserve(&mut self, count: usize) {
        self.points.reserve_exact(count);
        self.normals.reserve_exact(if self.has_normals { count } else { 0 });
        self.textures.reserve_exact(if self.has_textures { count } else { 0 });
    }

    fn push(&mut self, element: &Element) {
        self.points.push(DVec3::from(element.point));
        if self.has_normals {
            self.normals.push(DVec3::from(element.normal));
        }
        if self.has_textures {
            self.textures.push(element.texture);
        }
    }

    /// The triangle of three vertices.
    fn face(&self, corners: [usize; 3], collector: &Collector<'_>) -> Face {
        let normals = self.has_normals.then(|| corners.map(|corner| collector.meshes.normal(self.normals[corner])));
        let textures = self.has_textures.then(|| corners.map(|corner| self.textures[corner]));
        Face { directions: normals, textures, ..Face::flat(corners.map(|corner| self.points[corner])) }
    }
}

/// Adds the fan of triangles of a polygon. Fewer than three corners are none.
fn add_face(
    corners: &[i64],
    vertices: &Vertices,
    place: &dyn Fn() -> String,
    collector: &mut Collector<'_>,
) -> Result<(), PackError> {
    let count = vertices.points.len();
    let point = |number: i64| {
        let point = usize::try_from(number).ok().filter(|number| *number < count);
        point.ok_or_else(|| {
            let problem = format!("vertex {number}; there are {count}, counted from 0; export the part again");
            PackError::input(place(), problem)
        })
    };
    let [first, rest @ ..] = corners else { return Ok(()) };
    for pair in rest.windows(2) {
        let face = vertices.face([point(*first)?, point(pair[0])?, point(pair[1])?], collector);
        collector.meshes.face(&face, place)?;
    }
    Ok(())
}

/// What follows the head.
struct Elements {
    reader: BufReader<Source>,
    encoding: Encoding,
    parser: Parser<Element>,
    line: String,
    line_number: u64,
}

impl Elements {
    fn next(&mut self, definition: &ElementDef) -> Result<Element, String> {
        if self.encoding == Encoding::Ascii {
            self.line.clear();
            self.line_number += 1;
            let in_line = |problem: String| format!("line {}: {problem}", self.line_number);
            self.reader.read_line(&mut self.line).map_err(|error| in_line(error.to_string()))?;
            return self.parser.read_ascii_element(&self.line, definition).map_err(|error| in_line(said(&error)));
        }
        let mut element = (&mut self.reader).take(MAX_LINE_BYTES as u64);
        let found = match self.encoding {
            Encoding::BinaryBigEndian => self.parser.read_big_endian_element(&mut element, definition),
            _ => self.parser.read_little_endian_element(&mut element, definition),
        };
        found.map_err(|error| match element.limit() {
            0 => format!("more than {MAX_LINE_BYTES} bytes"),
            _ => said(&error),
        })
    }
}

/// What the library says, on one line, without what its grammar would have taken.
fn said(error: &ParseError) -> String {
    let text = error.to_string();
    let text = text.split("\tError: ParseError").next().unwrap_or_default();
    let text = plain_line(&text.replace(['\n', '\r', '\t'], " "));
    let words: Vec<_> = text.split_whitespace().collect();
    words.join(" ").trim_end_matches('.').chars().take(MAX_QUOTE_CHARS).collect()
}

/// A vertex or a face. Other elements and properties leave nothing.
struct Element {
    point: [f64; 3],
    normal: [f64; 3],
    texture: [f64; 2],
    corners: Vec<i64>,
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self { point: [0.0; 3], normal: [0.0; 3], texture: [0.0; 2], corners: Vec::new() }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if let Some(number) = self.number(name) {
            match scalar(&property) {
                Some(value) => *number = value,
                None => return PropertyAccessResult::Ignored,
            }
        } else if ply_head::CORNERS.contains(&name) {
            match list(&property) {
                Some(corners) => self.corners = corners,
                None => return PropertyAccessResult::Ignored,
            }
        }
        PropertyAccessResult::Set
    }
}

impl Element {
    /// The number that a property is.
    fn number(&mut self, name: &str) -> Option<&mut f64> {
        let in_names = |names: &[&str]| names.iter().position(|other| *other == name);
        if let Some(axis) = in_names(&ply_head::AXES) {
            return Some(&mut self.point[axis]);
        }
        if let Some(axis) = in_names(&ply_head::NORMALS) {
            return Some(&mut self.normal[axis]);
        }
        let axis = ply_head::TEXTURES.iter().find_map(|names| in_names(names))?;
        Some(&mut self.texture[axis])
    }
}

fn scalar(property: &Property) -> Option<f64> {
    Some(match *property {
        Property::Char(value) => value.into(),
        Property::UChar(value) => value.into(),
        Property::Short(value) => value.into(),
        Property::UShort(value) => value.into(),
        Property::Int(value) => value.into(),
        Property::UInt(value) => value.into(),
        Property::Float(value) => value.into(),
        Property::Double(value) => value,
        _ => return None,
    })
}

fn list(property: &Property) -> Option<Vec<i64>> {
    fn wide<T: Copy + Into<i64>>(values: &[T]) -> Vec<i64> {
        values.iter().map(|value| (*value).into()).collect()
    }
    Some(match property {
        Property::ListChar(values) => wide(values),
        Property::ListUChar(values) => wide(values),
        Property::ListShort(values) => wide(values),
        Property::ListUShort(values) => wide(values),
        Property::ListInt(values) => wide(values),
        Property::ListUInt(values) => wide(values),
        _ => return None,
    })
}
