//! Scan vectors: from the field of a layer to what a laser marks.
//!
//! A layer is cut along its border into [`Region`]s, and each is filled by the rules of [`ScanSettings`]. [`Contours`] computes the
//! regions: it draws the field, finds where the border crosses the grid of pixels, and leaves out points within a tolerance. [`Fill`] makes
//! vectors of them.
//!
//! ```
//! use layerd::buildfile::{BodySettings, BuildFile, Caps, Joint, Placement, Shares, Strut, Writer, WriterSettings};
//! use layerd::layer::{Depth, Mirror, Raster};
//! use layerd::slice::scan::Contours;
//! use layerd::slice::{BodySource, SlicePlan};
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
//! // Besides what is known before, this layer takes a few kilobytes.
//! let budget = MemoryBudget::new(Contours::memory_bytes(&bodies, &plan, 1) + (1 << 20));
//! let mut contours = Contours::new(bodies, plan, 5.0, 1, 70, &budget)?;
//! let layer = contours.next_layer()?.expect("layer 70 is in the middle of the post");
//! let [disc] = layer.regions() else { panic!("one region") };
//! let area_um2 = std::f64::consts::PI * 1000.0_f64.powi(2);
//! assert!(disc.holes.is_empty() && (disc.area_um2() - area_um2).abs() < 0.001 * area_um2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bare;
mod border;
mod charged;
mod contour;
mod contours;
mod convex;
mod counts;
mod field;
mod fill;
mod hatch;
mod join;
mod layer_plan;
mod memory;
mod middle;
mod nest;
mod offset;
mod order;
mod path;
mod pen;
mod pieces;
mod region;
mod settings;
mod simplify;
mod skin;
mod stitch;
mod thin;
mod tour;
mod tree;
mod trim;

pub use contours::{ContourTimes, Contours, LayerRegions};
pub use counts::ScanCounts;
pub use fill::{Fill, FillError, Neighbours};
pub use layer_plan::FillTimes;
pub use offset::MAX_FIELD_UM;
pub use region::{Region, Ring};
pub use settings::{HatchSettings, HatchStrategy, ScanSettings, SettingsError};
