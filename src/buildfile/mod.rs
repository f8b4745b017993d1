//! The build file (`.layerd`): a part as bodies. Each body is a sequence of struts, triangles or patches in ascending z, compressed in chunks, which are
//! read in one forward stream.
//!
//! [`pack`] imports lattices and solids and sorts them with limited memory. [`generate`] makes lattices. [`Writer`] writes a file and
//! [`BuildFile`] reads it: forward, from any layer on. Header, index and profile bound the active set of every layer before a chunk is
//! read. `docs/build-file.md` describes every byte.
//!
//! ```
//! use layerd::buildfile::{BuildFile, PackOptions, pack};
//! # let directory = tempfile::tempdir()?;
//! # let [source, output] = ["edges.txt", "part.layerd"].map(|name| directory.path().join(name));
//! // Two struts that share a node, millimetres.
//! std::fs::write(&source, "2 0.5 0.75 0\n0 0 0 0 0 9\n0 0 9 7 0 9 0.25\n")?;
//! let report = pack(&[source], &output, &PackOptions::default(), &mut |_| {})?;
//! let lattice = report.header.lattices().next().expect("a part has a body");
//! assert_eq!((lattice.strut_count, lattice.node_count, lattice.radius_range), (2, 3, [250, 500]));
//! let file = BuildFile::open(&output)?;
//! file.verify()?;
//! let mut struts = Vec::new();
//! file.read_chunk(0, &mut struts)?;
//! assert_eq!((struts[0].a, struts[0].b), ([0, 0, 0], [0, 0, 9000]));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod generate;
mod import;
mod materials;
mod measure;
mod model;
mod options;
mod pack;
mod primitive;
mod progress;
mod relief;
mod sort;
mod store;

pub use error::PackError;
pub use generate::{GenerateOptions, Height, Kind, generate};
pub use materials::{Materials, Shares, Split};
pub use model::{
    BodyHeader, Bounds, Cap, Caps, Clip, Header, Joint, Keeps, Lattice, Placement, QUANTUM_FRACTIONS, Strut, Surface,
    Triangle,
};
pub use options::{BlendBegin, DisplacementOptions, JointChoice, PackOptions, ReliefOptions};
pub use pack::{PackReport, pack};
pub use progress::PackProgress;
pub(crate) use relief::ReliefShape;
pub use relief::{
    Corner, DIRECTION_UNIT, Displacement, FACTOR_FRACTIONS, MapHeader, Patch, Relief, TEXTURE_FRACTIONS, Tile,
};
pub(crate) use store::map_decoding_bytes;
pub(crate) use store::{BEGINNING_BYTES, MAX_CHUNK_PRIMITIVES, check_beginning};
pub use store::{
    BodySettings, BuildFile, BuildFileError, ChunkEntry, ReliefMap, ReliefSettings, WriteError, Writer, WriterSettings,
};
