//! The build file (`.layerd`): a part as bodies, each of struts in ascending z, compressed in chunks that are read in one forward
//! stream.
//!
//! [`pack`] imports 3MF and edge text and sorts them out of core, [`Writer`] writes, [`BuildFile`] reads: forward, or from any
//! layer by the index, which also bounds the active set of every layer before a single chunk is read.

mod error;
mod generate;
mod import;
mod model;
mod options;
mod pack;
mod progress;
mod sort;
mod store;

pub use error::PackError;
pub use generate::{GenerateOptions, Height, Kind, generate};
pub use model::{Blend, BodyHeader, Bounds, Cap, Caps, Header, Lattice, Placement, Strut};
pub use options::{BlendChoice, PackOptions};
pub use pack::{PackReport, pack};
pub use progress::PackProgress;
pub use store::{
    BEGINNING_BYTES, BodySettings, BuildFile, BuildFileError, CHUNK_STRUTS, ChunkEntry, WriteError, Writer,
    WriterSettings, check_beginning,
};
