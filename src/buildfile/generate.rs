//! Synthetic lattices for demos and benchmarks, written in ascending z layer by layer: hundreds of millions of struts fit.

use std::path::Path;

use sha2::{Digest, Sha256};

use super::chunk::node_key;
use super::model::{Blend, Caps, Header, Placement, Strut};
use super::pack::PackError;
use super::sort::Sorter;
use super::writer::{Writer, WriterSettings};

/// Memory for sorting one layer of nodes; a wider layer is sorted out of core.
const LAYER_MEMORY_BYTES: u64 = 64 << 20;

const QUANTUM_UM: f64 = 1.0;

/// Default radius as a share of the least cell edge: slender, yet four pixels wide in a 2 mm cell at 50 µm.
const RADIUS_SHARE: f64 = 0.1;

/// How far a node of [`Kind::Random`] leaves its grid point along each axis, as a share of the cell.
const JITTER: f64 = 0.25;

/// Kernel support as a multiple of the radius, as for imported lattices.
const SUPPORT_FACTOR: f64 = 1.5;

/// What is repeated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Body-centred cubic: eight half diagonals a cell.
    Bcc,
    /// Octet truss: nearest neighbours of a face-centred cubic grid, 24 struts a cell.
    Octet,
    /// Jittered nodes joined as a tetrahedral mesh joins them: 14 struts at each inner node, 7 a cell.
    Random,
}

/// What to generate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GenerateOptions {
    /// What is repeated.
    pub kind: Kind,
    /// About this many struts, 1 to 10⁹.
    pub struts: u64,
    /// Edges of the box the nodes fill, 0.1 to 10,000 mm.
    pub box_mm: [f64; 3],
    /// Strut radius; where none is given, a tenth of the least cell edge.
    pub radius_mm: Option<f64>,
    /// Seed of [`Kind::Random`].
    pub seed: u64,
}

/// Upward halves of the neighbourhoods, on a grid of half cells (whole cells for [`Kind::Random`]).
const BCC: &[[i64; 3]] = &[[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]];
const OCTET: &[[i64; 3]] = &[[1, 1, 0], [-1, 1, 0], [1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]];
const RANDOM: &[[i64; 3]] = &[[1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]];

impl Kind {
    fn neighbours(self) -> &'static [[i64; 3]] {
        match self {
            Self::Bcc => BCC,
            Self::Octet => OCTET,
            Self::Random => RANDOM,
        }
    }

    /// Grid steps a cell and struts a cell.
    fn density(self) -> (i64, f64) {
        match self {
            Self::Bcc => (2, 8.0),
            Self::Octet => (2, 24.0),
            Self::Random => (1, 7.0),
        }
    }

    fn is_node(self, [i, j, k]: [i64; 3]) -> bool {
        match self {
            Self::Bcc => (i ^ j) & 1 == 0 && (j ^ k) & 1 == 0,
            Self::Octet => (i + j + k) & 1 == 0,
            Self::Random => true,
        }
    }
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
    let grid = Grid::new(options)?;
    let radius = grid.radius(options)?;
    let settings = WriterSettings {
        quantum_um: QUANTUM_UM,
        blend: Blend::Convolution { support_um: SUPPORT_FACTOR * f64::from(radius) * QUANTUM_UM },
        largest_radius: radius,
        placement: Placement::Centred,
        source_digest: Sha256::digest(format!("{options:?}").as_bytes()).into(),
        source_name: format!("generated {:?}, seed {}", options.kind, options.seed).to_lowercase(),
    };
    let mut writer = Writer::create(output, settings)?;
    let directory = match output.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    let sort_error = |source| PackError::Sort { directory: directory.into(), source };
    for k in 0..=grid.steps[2] {
        let mut layer = Sorter::new(directory, LAYER_MEMORY_BYTES);
        grid.layer(k, radius, &mut |strut| layer.push(strut)).map_err(sort_error)?;
        for strut in layer.finish().map_err(sort_error)? {
            writer.push(strut.map_err(sort_error)?)?;
        }
        progress(k as u64 + 1, grid.steps[2] as u64 + 1);
    }
    Ok(writer.finish()?)
}

struct Grid {
    kind: Kind,
    seed: u64,
    /// Grid steps along each axis; nodes stand at 0 to this.
    steps: [i64; 3],
    /// Length of one step in quanta.
    pitch: [f64; 3],
}

impl Grid {
    fn new(options: &GenerateOptions) -> Result<Self, PackError> {
        let GenerateOptions { kind, struts, box_mm, seed, .. } = *options;
        if !(1..=1_000_000_000).contains(&struts) {
            return Err(PackError::Option(format!("--struts {struts}: allowed is 1 to 1000000000")));
        }
        if let Some(edge) = box_mm.iter().find(|edge| !(0.1..=1e4).contains(*edge)) {
            return Err(PackError::Option(format!("--box with an edge of {edge} mm: allowed is 0.1 to 10000 mm")));
        }
        let (steps_per_cell, struts_per_cell) = kind.density();
        let cell_mm = (box_mm.iter().product::<f64>() * struts_per_cell / struts as f64).cbrt();
        let steps = box_mm.map(|edge| (edge / cell_mm).round().max(1.0) as i64 * steps_per_cell);
        let pitch = [0, 1, 2].map(|axis| box_mm[axis] * 1000.0 / QUANTUM_UM / steps[axis] as f64);
        if let Some(pitch) = pitch.iter().find(|pitch| **pitch < 10.0) {
            let problem =
                format!("--struts {struts}: nodes {pitch:.1} µm apart in this box; ask for fewer or a larger --box");
            return Err(PackError::Option(problem));
        }
        Ok(Self { kind, seed, steps, pitch })
    }

    fn radius(&self, options: &GenerateOptions) -> Result<u32, PackError> {
        let cell = self.pitch.iter().copied().fold(f64::INFINITY, f64::min) * self.kind.density().0 as f64;
        let quanta = options.radius_mm.map_or(RADIUS_SHARE * cell, |radius_mm| radius_mm * 1000.0 / QUANTUM_UM).round();
        if !(1.0..=1e7).contains(&quanta) {
            let radius_mm = quanta * QUANTUM_UM / 1000.0;
            return Err(PackError::Option(format!("--radius {radius_mm}: allowed is 0.001 to 10000 mm")));
        }
        Ok(quanta as u32)
    }

    /// Hands over the struts whose lower grid node lies in layer `k`. Layers do not overlap: jitter stays below half a step.
    fn layer<E>(&self, k: i64, radius: u32, emit: &mut dyn FnMut(Strut) -> Result<(), E>) -> Result<(), E> {
        for j in 0..=self.steps[1] {
            for i in 0..=self.steps[0] {
                if !self.kind.is_node([i, j, k]) {
                    continue;
                }
                for step in self.kind.neighbours() {
                    let other = [i + step[0], j + step[1], k + step[2]];
                    if (0..3).any(|axis| !(0..=self.steps[axis]).contains(&other[axis])) {
                        continue;
                    }
                    let mut ends = [self.node([i, j, k]), self.node(other)];
                    ends.sort_unstable_by_key(|&node| node_key(node));
                    let [a, b] = ends;
                    emit(Strut { a, b, radius_a: radius, radius_b: radius, caps: Caps::default() })?;
                }
            }
        }
        Ok(())
    }

    fn node(&self, place: [i64; 3]) -> [i32; 3] {
        [0, 1, 2].map(|axis| {
            let mut at = place[axis] as f64;
            if self.kind == Kind::Random && place[axis] > 0 && place[axis] < self.steps[axis] {
                at += JITTER * self.noise(place, axis as u64);
            }
            (at * self.pitch[axis]).round() as i32
        })
    }

    /// A number from -1 to 1 that depends on seed, node and axis alone.
    fn noise(&self, place: [i64; 3], axis: u64) -> f64 {
        let mixed = place.iter().fold(mix(self.seed ^ axis), |state, &value| mix(state ^ value as u64));
        mixed as f64 / u64::MAX as f64 * 2.0 - 1.0
    }
}

/// The output function of SplitMix64 (Steele, Lea & Flood 2014).
fn mix(state: u64) -> u64 {
    let mut z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}
