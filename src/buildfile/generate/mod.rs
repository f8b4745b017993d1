//! Synthetic lattices for demos and benchmarks. They are written in ascending z, layer by layer, so they may have hundreds of millions of
//! struts.
//!
//! `grid` computes the struts of a lattice, `fit` the size of the grid.
//!
//! ```
//! use layerd::buildfile::{GenerateOptions, Height, Kind, generate};
//! # let directory = tempfile::tempdir()?;
//! # let output = directory.path().join("bcc.layerd");
//! let (kind, height) = (Kind::Bcc, Height::Mm(10.0));
//! let options = GenerateOptions { kind, struts: 500, footprint_mm: [20.0; 2], height, radius_mm: None, seed: 0 };
//! let header = generate(&output, &options, &mut |_, _| {})?;
//! assert_eq!(header.lattices().map(|lattice| lattice.strut_count).sum::<u64>(), 500);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod fit;
mod grid;

use std::path::Path;

use sha2::{Digest, Sha256};

use self::fit::fit;
use super::error::PackError;
use super::model::{Header, Joint, Placement};
use super::sort::Sorter;
use super::store::{BodySettings, Writer, WriterSettings};
use crate::output;

/// Memory for sorting the struts of one layer of nodes. A wider layer is sorted on the disk.
const LAYER_MEMORY_BYTES: u64 = 64 << 20;

/// Length of a quantum, micrometres.
const QUANTUM_UM: f64 = 1.0;

/// The structure of a lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Body-centred cubic: eight half diagonals per cell.
    Bcc,
    /// Octet truss: struts between nearest neighbours of a face-centred cubic grid, 24 per cell.
    Octet,
    /// The edges of an irregular tetrahedral mesh. Its nodes are those of a body-centred cubic grid, each moved at random. 14 struts meet
    /// at each inner node. Radii are half to one and a half times the mean.
    Random,
}

/// Options of [`generate`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GenerateOptions {
    /// The structure.
    pub kind: Kind,
    /// Exact number of struts, 1 to 10⁹. If whole cells have more, some are left out at random.
    pub struts: u64,
    /// Edges along x and y of the box that the nodes fill, 0.1 to 10,000 mm.
    pub footprint_mm: [f64; 2],
    /// Edge of the box along z.
    pub height: Height,
    /// Strut radius, of [`Kind::Random`] the mean. `None` is a tenth of the shortest edge of a cell.
    pub radius_mm: Option<f64>,
    /// Seed of all random choices.
    pub seed: u64,
}

/// Edge of the box along z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Height {
    /// This length, 0.1 to 10,000 mm.
    Mm(f64),
    /// The height at which this number of struts, within 5 %, are within reach of the plane that reaches most of them.
    Active(u64),
}

/// Writes a lattice. The same options give the same file. `progress` takes the layers of nodes done, and their total.
///
/// # Errors
/// [`PackError`] names the option that is out of range, or says why the file could not be written.
pub fn generate(
    output: &Path,
    options: &GenerateOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Header, PackError> {
    let (grid, radii) = fit(options)?;
    let joint = Joint::Convolution { support_um: radii.support() * QUANTUM_UM };
    let settings = WriterSettings {
        materials: None,
        quantum_um: QUANTUM_UM,
        placement: Placement::Centred,
        source_digest: Sha256::digest(format!("{options:?}").as_bytes()).into(),
        source_name: format!("generated {:?}, seed {}", options.kind, options.seed).to_lowercase(),
        bodies: vec![BodySettings::Lattice { joint, largest_radius: radii.largest() }],
    };
    let mut writer = Writer::create(output, settings)?;
    let directory = output::directory_of(output);
    let sort_error = |source| PackError::Sort { directory: directory.into(), source };
    let mut choice = grid.choice(options.struts);
    for k in 0..grid.layer_count() {
        let mut layer = Sorter::new(directory, LAYER_MEMORY_BYTES);
        let mut pushed = Ok(());
        grid.layer(k, &radii, &mut choice, &mut |strut| {
            if pushed.is_ok() {
                pushed = layer.push(strut);
            }
        });
        pushed.map_err(sort_error)?;
        for strut in layer.finish().map_err(sort_error)? {
            writer.push(strut.map_err(sort_error)?)?;
        }
        progress(k as u64 + 1, grid.layer_count() as u64);
    }
    Ok(writer.finish()?)
}
