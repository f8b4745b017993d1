//! STL, binary and text, millimetres. The library reads one triangle after the other. Normals in the file are not used: the order of the
//! corners says which side is outside. `tests/pack_mesh.rs` has examples.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use glam::DVec3;
use sha2::{Digest, Sha256};

use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::progress::PackProgress;

/// Length of a binary file: a head with the number of triangles, then so many bytes for each.
const HEAD_BYTES: u64 = 84;
const TRIANGLE_BYTES: u64 = 50;

/// Shortest text of a triangle: `facet normal 0 0 1`, `outer loop`, three times `vertex 0 0 0`, `endloop`, `endfacet`.
const MIN_TEXT_BYTES: u64 = 80;

/// Longest line of a text: a name may be long, a line without end is not STL.
const MAX_LINE_BYTES: usize = 4096;

/// How often progress is reported, triangles.
const REPORT_EVERY: u64 = 1 << 14;

/// Reads one file.
///
/// # Errors
/// [`PackError`] names the file and the triangle.
pub(in crate::buildfile::import) fn import(
    path: &Path,
    collector: &mut Collector<'_>,
    progress: &mut dyn FnMut(PackProgress),
) -> Result<(), PackError> {
    let read_error = |source| PackError::Read { path: path.into(), source };
    let mut file = File::open(path).map_err(read_error)?;
    let total = file.metadata().map_err(read_error)?.len();
    let form = Form::of(&mut file, total).map_err(read_error)?;
    let most = form.check(path, total)?;
    collector.expect_triangles(most, progress)?;
    let mut source = Source { file, form, at: 0, line_bytes: 0, digest: Sha256::new(), digested: 0 };
    let mut seen = 0;
    let wrong = |seen: u64, error: &io::Error| {
        let problem = format!("triangle {}: {error}; export the part again as binary STL", seen + 1);
        PackError::input(path.display().to_string(), problem)
    };
    let triangles = stl_io::create_stl_reader(&mut source).map_err(|error| wrong(0, &error))?;
    for triangle in triangles {
        let triangle = triangle.map_err(|error| wrong(seen, &error))?;
        let corners = triangle.vertices.map(|vertex| DVec3::from(vertex.0.map(f64::from)));
        collector.triangle(corners, &|| format!("{}: triangle {}", path.display(), seen + 1))?;
        if seen.is_multiple_of(REPORT_EVERY) {
            progress(PackProgress::Reading { done: total.min(form.bytes_of(seen)), total });
        }
        seen += 1;
    }
    if seen == 0 {
        return Err(PackError::input(path.display().to_string(), "it has no triangles"));
    }
    source.finish(collector).map_err(read_error)?;
    collector.end_solid(&path.display().to_string())
}

/// The form of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Binary {
        /// As the head states it.
        triangles: u64,
        /// The file begins like a text, but has the length of a binary one: some programs write such heads.
        looks_like_text: bool,
    },
    Text,
}

impl Form {
    fn of(file: &mut File, length: u64) -> io::Result<Self> {
        let mut head = Vec::new();
        file.take(HEAD_BYTES).read_to_end(&mut head)?;
        file.seek(SeekFrom::Start(0))?;
        let triangles = head.last_chunk::<4>().map_or(0, |count| u64::from(u32::from_le_bytes(*count)));
        let looks_like_text = head.starts_with(b"solid ");
        let is_binary = length == HEAD_BYTES + triangles * TRIANGLE_BYTES;
        Ok(if looks_like_text && !is_binary { Self::Text } else { Self::Binary { triangles, looks_like_text } })
    }

    /// Refuses a binary file of another length than its head states. Returns the most triangles that the file can hold.
    fn check(self, path: &Path, length: u64) -> Result<u64, PackError> {
        let Self::Binary { triangles, .. } = self else { return Ok(length / MIN_TEXT_BYTES) };
        if length < HEAD_BYTES {
            let problem = format!("{length} bytes are too few for STL; is the file cut short?");
            return Err(PackError::input(path.display().to_string(), problem));
        }
        let wanted = HEAD_BYTES + triangles * TRIANGLE_BYTES;
        if length < wanted {
            let problem = format!(
                "its head announces {triangles} triangles, which take {wanted} bytes, but the file has {length}; is it cut short?"
            );
            return Err(PackError::input(path.display().to_string(), problem));
        }
        Ok(triangles)
    }

    /// About where triangle `number` lies.
    fn bytes_of(self, number: u64) -> u64 {
        match self {
            Self::Binary { .. } => HEAD_BYTES + number * TRIANGLE_BYTES,
            // A usual text.
            Self::Text => number * 3 * MIN_TEXT_BYTES,
        }
    }
}

/// The file as the library reads it: without lines that never end, and with a head that it does not take for text. It also computes the
/// digest.
struct Source {
    file: File,
    form: Form,
    at: u64,
    /// Bytes since the last end of a line.
    line_bytes: usize,
    digest: Sha256,
    /// Bytes in the digest. The library reads the beginning twice.
    digested: u64,
}

impl Source {
    /// Adds the digest of the file to the collector's.
    fn finish(mut self, collector: &mut Collector<'_>) -> io::Result<()> {
        // The library may leave the end of the file unread.
        let mut buffer = vec![0; 64 << 10];
        self.seek(SeekFrom::Start(self.digested))?;
        self.form = Form::Binary { triangles: 0, looks_like_text: false };
        while self.read(&mut buffer)? > 0 {}
        let (_, digest) = collector.parts();
        digest.update(self.digest.finalize());
        Ok(())
    }
}

impl Read for Source {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        let bytes = &mut buffer[..count];
        let known = self.digested.saturating_sub(self.at).min(count as u64) as usize;
        self.digest.update(&bytes[known..]);
        self.digested += (count - known) as u64;
        if self.form == Form::Text {
            for line in bytes.split_inclusive(|byte| *byte == b'\n') {
                self.line_bytes += line.len();
                if self.line_bytes > MAX_LINE_BYTES {
                    let problem = format!("a line of more than {MAX_LINE_BYTES} bytes");
                    return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
                }
                if line.ends_with(b"\n") {
                    self.line_bytes = 0;
                }
            }
        }
        if let (Form::Binary { looks_like_text: true, .. }, 0, Some(first)) = (self.form, self.at, bytes.first_mut()) {
            *first = b' ';
        }
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Source {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.line_bytes = 0;
        self.at = self.file.seek(to)?;
        Ok(self.at)
    }
}
