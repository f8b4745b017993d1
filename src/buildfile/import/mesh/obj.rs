//! OBJ, millimetres: vertices and faces of all objects and groups are one solid. The library gets nothing else of the file, so that
//! normals, texture coordinates, colours and materials can do no harm, and no other file is read. `tests/pack_mesh/obj.rs` has examples.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use glam::DVec3;
use tobj::{LoadError, LoadOptions};

use super::source::Source;
use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::import::digest;
use crate::buildfile::progress::PackProgress;
use crate::text::{plain_line, size_text};

/// What the library holds in memory. Of a vertex: 24 bytes as read and 24 as handed over, and an entry of 17 bytes in a hash table, of
/// which at least 7 in 16 are in use. Of a face: an enumeration of 104 bytes. Of a corner: 24 bytes in a polygon, and 12 for its triangle.
const VERTEX_BYTES: u64 = 24 + 24 + 17 * 16 / 7;
const FACE_BYTES: u64 = 104;
const CORNER_BYTES: u64 = 24 + 12;

/// How often progress is reported, lines.
const REPORT_EVERY: u64 = 1 << 14;

/// Reads one file. `memory_bytes` is what it may take.
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
    let source = Source::open(path).map_err(|source| PackError::Read { path: path.into(), source })?;
    let mut statements = Statements::new(source, memory_bytes, progress);
    let options = LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..LoadOptions::default() };
    // No `mtllib` reaches the library.
    let loaded = tobj::load_obj_buf(&mut statements, &options, |_| Err(LoadError::OpenFileFailed));
    let models = match loaded {
        Ok((models, _)) => models,
        Err(error) => return Err(PackError::input(name, statements.why(error))),
    };
    let count = models.iter().map(|model| model.mesh.indices.len() as u64 / 3).sum();
    if count == 0 {
        return Err(PackError::input(name, "it has no faces; export the part again as a mesh of triangles"));
    }
    collector.expect_triangles(count, progress)?;
    let mut seen = 0_u64;
    for mesh in models.iter().map(|model| &model.mesh) {
        let (points, _) = mesh.positions.as_chunks::<3>();
        let (triangles, _) = mesh.indices.as_chunks::<3>();
        for corners in triangles {
            seen += 1;
            let corners = corners.map(|corner| DVec3::from(points[corner as usize]));
            collector.triangle(corners, &|| format!("{name}: triangle {seen}"))?;
        }
    }
    digest(path, collector)?;
    collector.end_solid(&name)
}

/// The lines that the library gets: `v X Y Z [W]`, and `f A B C …` with numbers of vertices only.
struct Statements<'a> {
    lines: BufReader<Source>,
    /// The rest of the line that the library reads.
    line: Vec<u8>,
    at: usize,
    number: u64,
    read_bytes: u64,
    vertices: u64,
    /// The largest number of a vertex, and the first line that has it.
    largest: (u64, u64),
    needed_bytes: u64,
    memory_bytes: u64,
    /// Why the library got no more lines.
    stopped: Option<String>,
    progress: &'a mut dyn FnMut(PackProgress),
}

impl<'a> Statements<'a> {
    fn new(source: Source, memory_bytes: u64, progress: &'a mut dyn FnMut(PackProgress)) -> Self {
        Self {
            lines: BufReader::with_capacity(64 << 10, source),
            line: Vec::new(),
            at: 0,
            number: 0,
            read_bytes: 0,
            vertices: 0,
            largest: (0, 0),
            needed_bytes: 0,
            memory_bytes,
            stopped: None,
            progress,
        }
    }

    /// The problem behind an error of the library.
    fn why(&self, error: LoadError) -> String {
        let problem = match (&self.stopped, error) {
            (Some(stopped), _) => stopped.clone(),
            (None, LoadError::FaceVertexOutOfBounds) => {
                let (vertex, line) = self.largest;
                return format!(
                    "line {line}: vertex {vertex}; there are {} vertices; export the part again",
                    self.vertices
                );
            }
            (None, error) => format!("{error}; export the part again"),
        };
        format!("line {}: {problem}", self.number)
    }

    /// Reads lines up to the next one for the library, or the end of the file.
    fn next_line(&mut self) -> Result<(), String> {
        let mut raw = Vec::new();
        self.line.clear();
        self.at = 0;
        while self.line.is_empty() {
            raw.clear();
            self.number += 1;
            self.read_bytes += self.lines.read_until(b'\n', &mut raw).map_err(|error| error.to_string())? as u64;
            if raw.is_empty() {
                break;
            }
            if self.number.is_multiple_of(REPORT_EVERY) {
                let total = self.lines.get_ref().length;
                (self.progress)(PackProgress::Reading { done: self.read_bytes.min(total), total });
            }
            let statement = raw.trim_ascii();
            if statement.starts_with(b"v ") || statement.starts_with(b"v\t") {
                self.vertex(text(statement)?);
            } else if statement.starts_with(b"f ") || statement.starts_with(b"f\t") {
                self.face(text(statement)?)?;
            }
            if self.needed_bytes > self.memory_bytes {
                return Err(format!(
                    "so far, the mesh takes {}, and --memory allows {}; give more, or export the part as binary STL, which takes less",
                    size_text(self.needed_bytes),
                    size_text(self.memory_bytes)
                ));
            }
        }
        Ok(())
    }

    fn vertex(&mut self, statement: &str) {
        let words: Vec<_> = statement.split_whitespace().collect();
        // Three more numbers are a colour.
        let kept = if words.len() == 7 { &words[..4] } else { &words };
        self.line = (kept.join(" ") + "\n").into_bytes();
        self.vertices += 1;
        self.needed_bytes += VERTEX_BYTES;
    }

    fn face(&mut self, statement: &str) -> Result<(), String> {
        let mut line = String::from("f");
        let mut corners = 0;
        for word in statement.split_whitespace().skip(1) {
            let vertex = word.split('/').next().unwrap_or_default();
            let number = vertex
                .parse::<i64>()
                .map_err(|_| format!("`{}` is no number of a vertex; export the part again", plain_line(word)))?;
            if number == 0 || number < 0 && number.unsigned_abs() > self.vertices {
                return Err(format!(
                    "vertex {number}; there are {} vertices before; export the part again",
                    self.vertices
                ));
            }
            if number > 0 && number.unsigned_abs() > self.largest.0 {
                self.largest = (number.unsigned_abs(), self.number);
            }
            line.push(' ');
            line += vertex;
            corners += 1;
        }
        // Fewer are a point or a line.
        if corners > 2 {
            self.line = (line + "\n").into_bytes();
            self.needed_bytes += FACE_BYTES + corners * CORNER_BYTES;
        }
        Ok(())
    }
}

fn text(statement: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(statement).map_err(|_| "it is no text; is it another kind of file?".into())
}

impl Read for Statements<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(buffer)?;
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for Statements<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.at == self.line.len()
            && let Err(problem) = self.next_line()
        {
            self.stopped = Some(problem);
            return Err(io::ErrorKind::InvalidData.into());
        }
        Ok(&self.line[self.at..])
    }

    fn consume(&mut self, count: usize) {
        self.at += count;
    }
}
