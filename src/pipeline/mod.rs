//! The way of a print: a part on a machine with a recipe becomes encoded layers, computed ahead, within the memory budget.
//!
//! A [`Placed`] part is a build file on a machine's raster. [`Placed::fit`] counts its memory and makes a [`Part`] of it, which
//! computes and encodes layers: one after the other ([`Part::encoded_layers`]), or ahead of the printer ([`Layers`]). A print, the
//! check of its bottom layers, `layerctl check` and `layerctl slice` all take this way, so that they see the same pixels.
//! `tests/check/` compares them.
//!
//! ```
//! use layerd::buildfile::{PackOptions, pack};
//! use layerd::config::{Folder, Machine, Recipe, find};
//! use layerd::device::encoding;
//! use layerd::pipeline::{Placed, Resolution};
//! use layerd::stream::MemoryBudget;
//! # let directory = tempfile::tempdir()?;
//! # let [source, file] = ["edges.txt", "part.layerd"].map(|name| directory.path().join(name));
//!
//! // One strut, 9 mm high and 1 mm thick.
//! std::fs::write(&source, "1 0.5\n0 0 0 0 0 9\n")?;
//! pack(&[source], &file, &PackOptions::default(), &mut |_| {})?;
//! let [machine, recipe] = [find(Folder::Machines, "sim-dlp")?, find(Folder::Recipes, "demo")?];
//! let machine = Machine::parse(&machine.path, &machine.text)?;
//! let recipe = Recipe::parse(&recipe.path, &recipe.text)?;
//!
//! let resolution = Resolution::of(&machine, &recipe);
//! let part = Placed::open(&file, &resolution)?.fit(1, 64 << 20)?;
//! let budget = MemoryBudget::new(64 << 20);
//! let mut layers = part.encoded_layers(100, encoding::best(resolution.depth), &budget)?;
//! let layer = layers.next().expect("a layer of 0.05 mm")?;
//! assert_eq!(layer.exposure, 100);
//! assert!(!layer.bytes.is_empty() && budget.used_bytes() > 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod layers;
mod memory;
mod part;
mod placed;
mod scan;
mod scanned;

pub use error::PartError;
pub use layers::Layers;
pub use memory::PrintMemory;
pub use part::{EncodedLayer, EncodedLayers, Part, ScanReport};
pub use placed::{Placed, Resolution};
pub use scan::Scan;
pub use scanned::{ScannedLayer, ScannedLayers};

use std::path::Path;
use std::sync::Arc;

use crate::buildfile::BuildFile;
pub(crate) use crate::buildfile::{BEGINNING_BYTES, check_beginning};
use crate::config::MAX_THREADS;
use crate::slice::{Slicer, Volume};

// The slicer allows every number of threads that the configuration allows.
const _: () = assert!(MAX_THREADS <= Slicer::MAX_THREADS);

/// Number of threads that compute layers where the configuration names none: one for each core.
pub fn default_threads() -> usize {
    Slicer::default_threads()
}

/// Samples about how much material each of 64 to 256 equal slabs of a part's height takes, the lowest first, mm³. Blocks; calls
/// `rest` after each slab.
///
/// # Errors
/// [`PartError`]: the file cannot be read, or sampling takes more memory than `limit_bytes`.
pub fn slab_volumes_mm3(path: &Path, limit_bytes: u64, rest: impl FnMut()) -> Result<Vec<f64>, PartError> {
    Ok(Volume::slabs(&Arc::new(BuildFile::open(path)?), limit_bytes, rest)?)
}
