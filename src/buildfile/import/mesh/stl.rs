//! STL, binary and text, millimetres. The library reads one triangle after the other. Normals in the file are not used: the order of the
//! corners says which side is outside. `tests/pack_mesh/stl.rs` has examples.

use std::io;
use std::path::Path;

use glam::DVec3;

use super::source::Source;
use crate::buildfile::error::PackError;
use crate::buildfile::import::collect::Collector;
use crate::buildfile::import::digest;
use crate::buildfile::import::relief::Face;
use crate::buildfile::progress::PackProgress;

/// Length of a binary file: a head with the number of triangles, then so many bytes for each.
const HEAD_BYTES: u64 = 84;
const TRIANGLE_BYTES: u64 = 50;

/// Shortest text of a triangle: `facet normal 0 0 1`, `outer loop`, three times `vertex 0 0 0`, `endloop`, `endfacet`.
const MIN_TEXT_BYTES: u64 = 80;

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
    let mut source = Source::open(path).map_err(read_error)?;
    let total = source.length;
    let form = Form::of(&source.head(HEAD_BYTES).map_err(read_error)?, total);
    source.is_text = form == Form::Text;
    // The library looks for text in the first line, however long it is, and some programs write heads that look like text.
    source.first = matches!(form, Form::Binary { .. }).then_some(b'\n');
    let most = form.check(path, total)?;
    collector.expect_triangles(most, progress)?;
    let mut seen = 0;
    let wrong = |seen: u64, error: &io::Error| {
        let problem = format!("triangle {}: {error}; export the part again as binary STL", seen + 1);
        PackError::input(path.display().to_string(), problem)
    };
    let triangles = stl_io::create_stl_reader(&mut source).map_err(|error| wrong(0, &error))?;
    for triangle in triangles {
        let triangle = triangle.map_err(|error| wrong(seen, &error))?;
        let corners = triangle.vertices.map(|vertex| DVec3::from(vertex.0.map(f64::from)));
        collector.meshes.face(&Face::flat(corners), &|| format!("{}: triangle {}", path.display(), seen + 1))?;
        if seen.is_multiple_of(REPORT_EVERY) {
            progress(PackProgress::Reading { done: total.min(form.bytes_of(seen)), total });
        }
        seen += 1;
    }
    if seen == 0 {
        return Err(PackError::input(path.display().to_string(), "it has no triangles"));
    }
    digest(path, collector)?;
    collector.meshes.end_solid(&path.display().to_string())
}

/// The form of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Binary {
        /// As the head states it.
        triangles: u64,
    },
    Text,
}

impl Form {
    fn of(head: &[u8], length: u64) -> Self {
        let triangles = head.last_chunk::<4>().map_or(0, |count| u64::from(u32::from_le_bytes(*count)));
        let looks_like_text = head.starts_with(b"solid ");
        let is_binary = length == HEAD_BYTES + triangles * TRIANGLE_BYTES;
        if looks_like_text && !is_binary { Self::Text } else { Self::Binary { triangles } }
    }

    /// Refuses a binary file of another length than its head states. Returns the most triangles that the file can hold.
    fn check(self, path: &Path, length: u64) -> Result<u64, PackError> {
        let Self::Binary { triangles } = self else { return Ok(length / MIN_TEXT_BYTES) };
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
