//! The build file (`.layerd`): a part as struts in ascending z, compressed in chunks that can be read in one forward stream.
//!
//! [`pack`] imports 3MF and edge text and sorts them out of core, [`Writer`] writes, [`BuildFile`] reads: forward, or from any
//! layer by the index, which also bounds the active set of every layer before a single chunk is read.

mod chunk;
mod collect;
mod columns;
mod encoders;
mod format;
mod generate;
mod import;
mod index;
mod lowest;
mod merge;
mod model;
mod nodes;
mod pack;
mod packer;
mod profile;
mod reader;
mod sort;
mod sort_key;
mod stretch;
mod writer;

pub use chunk::CHUNK_STRUTS;
pub use format::{BEGINNING_BYTES, check_beginning};
pub use generate::{GenerateOptions, Height, Kind, generate};
pub use index::ChunkEntry;
pub use model::{Blend, Bounds, Cap, Caps, Header, Placement, Strut};
pub use pack::{BlendChoice, PackError, PackOptions, PackProgress, PackReport, pack};
pub use reader::{BuildFile, BuildFileError};
pub use writer::{WriteError, Writer, WriterSettings};
