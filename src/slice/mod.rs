//! Slicing: computes the pixels of each layer of a part.
//!
//! A [`SlicePlan`] places a part on the raster of a machine. A [`Slicer`] moves a plane upwards through the bodies of the part, each read
//! from a [`BodySource`], and draws layer after layer, band by band, on the given number of threads. A layer depends on part and plan
//! alone: not on the number of threads, the instruction set, or the layer that the slicer began with.
//!
//! ```
//! use layerd::buildfile::{BodySettings, BuildFile, Caps, Joint, Placement, Shares, Strut, Writer, WriterSettings};
//! use layerd::layer::{Bitmap, Depth, Mirror, Raster};
//! use layerd::slice::{BodySource, SlicePlan, Slicer};
//! use layerd::stream::MemoryBudget;
//! # let directory = tempfile::tempdir()?;
//! # let path = directory.path().join("post.layerd");
//! // One post of 1 mm radius and 5 mm height, in quanta of 1 µm.
//! let settings = WriterSettings {
//!     materials: None,
//!     quantum_um: 1.0,
//!     placement: Placement::Centred,
//!     source_digest: [0; 32],
//!     source_name: "post".into(),
//!     bodies: vec![BodySettings::Lattice { joint: Joint::Union, largest_radius: 1000 }],
//! };
//! let mut writer = Writer::create(&path, settings)?;
//! let caps = Caps::default();
//! writer.push(Strut { a: [0, 0, 0], b: [0, 0, 5000], radius_a: 1000, radius_b: 1000, caps, shares: Shares::default() })?;
//! writer.finish()?;
//!
//! let file = std::sync::Arc::new(BuildFile::open(&path)?);
//! let raster =
//!     Raster { width_px: 64, height_px: 64, pixel_um: [50.0; 2], build_height_um: 9000.0, mirror: Mirror::default() };
//! let plan = SlicePlan::new(file.header(), raster, Depth::Bit, 50.0)?;
//! let bodies = BodySource::of(&file);
//! let budget = MemoryBudget::new(Slicer::memory_bytes(&bodies, &plan, 1));
//! // Layer 70 is in the middle of the post.
//! let mut slicer = Slicer::new(bodies, plan, 1, 70, &budget)?;
//! let mut bitmap = Bitmap::new(64, 64, Depth::Bit);
//! assert_eq!(slicer.next_layer(&mut bitmap)?, Some(70));
//! let lit: u32 = bitmap.data().iter().map(|byte| byte.count_ones()).sum();
//! let area_px = std::f64::consts::PI * (1000.0_f64 / 50.0).powi(2);
//! assert!((f64::from(lit) - area_px).abs() < 0.02 * area_px);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod band;
mod bodies;
mod body;
mod enclosed;
mod error;
mod footing;
mod inspection;
mod mask_slicer;
mod plan;
pub mod scan;
mod slicer;
mod volume;
mod walls;
mod workers;

pub use body::fields::FieldSource;
pub use body::source::{BodyPrimitive, ChunkSource, ChunkSpan, MemoryChunks, MemoryStruts, MemoryTriangles};
pub use body::{BodySource, JoinedLattice};
pub use error::SliceError;
pub use footing::Footing;
pub(crate) use inspection::add_layers;
pub use inspection::{Inspection, ThinWall, dark_top};
pub use mask_slicer::{MaskSlicer, MaskSources};
pub use plan::{PlanError, SlicePlan};
pub use slicer::Slicer;
pub use volume::{Estimate, Volume};
