//! Synthetic lattices for demos and benchmarks, written in ascending z layer by layer: hundreds of millions of struts fit.
//!
//! `grid` says where the struts of a lattice are, `fit` how large a grid must be.

mod fit;
mod grid;

use std::path::Path;

use sha2::{Digest, Sha256};

use self::fit::fit;
use super::error::PackError;
use super::model::{Blend, Header, Placement};
use super::sort::Sorter;
use super::store::{BodySettings, Writer, WriterSettings};
use crate::output;

/// Memory for sorting one layer of nodes; a wider layer is sorted out of core.
const LAYER_MEMORY_BYTES: u64 = 64 << 20;

const QUANTUM_UM: f64 = 1.0;

/// What is repeated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Body-centred cubic: eight half diagonals a cell.
    Bcc,
    /// Octet truss: nearest neighbours of a face-centred cubic grid, 24 struts a cell.
    Octet,
    /// The edges of an irregular tetrahedral mesh: nodes of a body-centred cubic grid, each moved, with 14 struts at each
    /// inner node and radii from half to one and a half of the mean.
    Random,
}

/// What to generate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GenerateOptions {
    /// What is repeated.
    pub kind: Kind,
    /// Exactly this many struts, 1 to 10⁹: where whole cells have more, some are left out here and there.
    pub struts: u64,
    /// Edges of the box the nodes fill along x and y, 0.1 to 10,000 mm.
    pub footprint_mm: [f64; 2],
    /// The box's third edge.
    pub height: Height,
    /// Strut radius, the mean one of [`Kind::Random`]; where none is given, a tenth of a cell's least edge.
    pub radius_mm: Option<f64>,
    /// Seed of all that is left to chance.
    pub seed: u64,
}

/// The edge of the box along z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Height {
    /// 0.1 to 10,000 mm.
    Mm(f64),
    /// As high as leaves this many struts within reach of the plane with most of them, within 5 %.
    Active(u64),
}

/// Writes a lattice; the same options give the same file. `progress` takes layers of nodes done and in all.
///
/// # Errors
/// [`PackError`] names the option that is out of range, or what the file system refused.
pub fn generate(
    output: &Path,
    options: &GenerateOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Header, PackError> {
    let (grid, radii) = fit(options)?;
    let blend = Blend::Convolution { support_um: radii.support() * QUANTUM_UM };
    let settings = WriterSettings {
        quantum_um: QUANTUM_UM,
        placement: Placement::Centred,
        source_digest: Sha256::digest(format!("{options:?}").as_bytes()).into(),
        source_name: format!("generated {:?}, seed {}", options.kind, options.seed).to_lowercase(),
        bodies: vec![BodySettings::Lattice { blend, largest_radius: radii.largest() }],
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
