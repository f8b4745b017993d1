//! Readers of sources. Each streams its file and hands beams and balls to the [`Collector`].

mod edge_text;
mod three_mf;

use std::path::Path;

use super::collect::Collector;
use super::pack::{PackError, PackOptions};

/// Reads one source; the last argument takes the bytes read so far.
pub(super) type Importer = fn(&Path, &PackOptions, &mut Collector<'_>, &mut dyn FnMut(u64)) -> Result<(), PackError>;

/// The reader for a file, by its extension.
///
/// # Errors
/// Where the extension is none that is known.
pub(super) fn importer(path: &Path) -> Result<Importer, PackError> {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("3mf") => Ok(three_mf::import),
        Some("txt") => Ok(edge_text::import),
        _ => Err(PackError::input(
            path.display().to_string(),
            "unknown kind of file; pack reads .3mf (3MF) and .txt (edge text)",
        )),
    }
}
