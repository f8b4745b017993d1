//! The file itself: chunks of struts with an index, written once and read forward or from any layer on.
//!
//! Used by `pack` and `generate`, which write, and by `slice` and the daemon, which read. `docs/build-file.md` draws every byte.

mod bottom;
mod chunk;
mod columns;
mod encoders;
mod error;
mod format;
mod index;
mod lowest;
mod nodes;
mod opening;
mod packer;
mod profile;
mod reader;
mod writer;

pub use chunk::CHUNK_STRUTS;
pub use error::BuildFileError;
pub use format::{BEGINNING_BYTES, check_beginning};
pub use index::ChunkEntry;
pub use reader::BuildFile;
pub(super) use writer::EXPECTED_STRUT_BYTES;
pub use writer::{BodySettings, WriteError, Writer, WriterSettings};
