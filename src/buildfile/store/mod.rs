//! The file itself: chunks with an index, written once, and read forward from any layer on.
//!
//! `pack` and `generate` write; `slice` and the daemon read. `docs/build-file.md` describes every byte.

mod bottom;
mod chunk;
mod chunker;
mod clipped;
mod control_points;
mod encoders;
mod error;
mod format;
mod index;
mod lattice;
mod lowest;
mod maps;
mod nodes;
mod opening;
mod packer;
mod profile;
mod reader;
mod relief;
mod settings;
mod surface;
mod verify;
mod writer;

pub(crate) use chunk::MAX_CHUNK_PRIMITIVES;
pub use error::BuildFileError;
pub(in crate::buildfile) use format::check_material_name;
pub(crate) use format::{BEGINNING_BYTES, check_beginning};
pub use index::ChunkEntry;
pub(crate) use maps::decoding_bytes as map_decoding_bytes;
pub(in crate::buildfile) use maps::{MAX_SIDE as MAX_MAP_SIDE, encode as encode_map};
pub use reader::BuildFile;
pub use settings::{BodySettings, ReliefMap, ReliefSettings, WriteError, WriterSettings};
pub use writer::Writer;
