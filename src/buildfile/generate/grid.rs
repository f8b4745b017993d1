//! The struts of a lattice. A hash of its grid position determines each node and each strut, so none has to be kept in memory.
//! `fit` chooses its size; `tests/generate.rs` tests it.

use super::Kind;
use crate::buildfile::materials::Shares;
use crate::buildfile::model::{Caps, SUPPORT_FACTOR, Strut, node_key};
use crate::random::mix;

/// Largest distance of a node of [`Kind::Random`] from its grid point along each axis, in grid steps. Below a half, so that the struts
/// of one layer of nodes begin below those of the next layer.
const JITTER: f64 = 0.4;

/// Largest deviation of the radii of [`Kind::Random`] from the mean, as a share of it: they vary by a factor of three.
const SPREAD: f64 = 0.5;

/// Offsets from a node to its upper neighbours, in grid steps of half a cell.
const BCC: &[[i64; 3]] = &[[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]];
const OCTET: &[[i64; 3]] = &[[1, 1, 0], [-1, 1, 0], [1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]];
/// The edges of the tetrahedra whose corners are the nodes of a body-centred grid.
const RANDOM: &[[i64; 3]] = &[[2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]];

impl Kind {
    fn neighbours(self) -> &'static [[i64; 3]] {
        match self {
            Self::Bcc => BCC,
            Self::Octet => OCTET,
            Self::Random => RANDOM,
        }
    }

    /// Struts per cube of one grid step in the inside of a large lattice.
    pub(super) fn density(self) -> f64 {
        match self {
            Self::Bcc => 1.0,
            Self::Octet => 3.0,
            Self::Random => 1.75,
        }
    }

    /// The number of grid steps along each axis is a multiple of this, so that the box has whole cells.
    pub(super) fn steps_multiple(self) -> i64 {
        match self {
            Self::Bcc | Self::Octet => 2,
            Self::Random => 1,
        }
    }

    fn is_node(self, [i, j, k]: [i64; 3]) -> bool {
        match self {
            Self::Bcc | Self::Random => (i ^ j) & 1 == 0 && (j ^ k) & 1 == 0,
            Self::Octet => (i + j + k) & 1 == 0,
        }
    }
}

/// Radii of the struts, quanta.
#[derive(Clone, Copy, Debug)]
pub(super) struct Radii {
    mean: f64,
    spread: f64,
}

impl Radii {
    pub(super) fn new(kind: Kind, mean: f64) -> Self {
        Self { mean, spread: if kind == Kind::Random { SPREAD } else { 0.0 } }
    }

    pub(super) fn largest(&self) -> u32 {
        self.of(1.0)
    }

    /// Support R of the kernel.
    pub(super) fn support(&self) -> f64 {
        SUPPORT_FACTOR * f64::from(self.largest())
    }

    /// The radius for a random number from 0 to 1.
    fn of(&self, chance: f64) -> u32 {
        (self.mean * (1.0 + self.spread * (2.0 * chance - 1.0))).round().max(1.0) as u32
    }
}

/// The grid of the nodes: grid points 0 to `steps` along each axis, some of which are nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    pub(super) kind: Kind,
    pub(super) seed: u64,
    pub(super) steps: [i64; 3],
    /// Length of one step in quanta.
    pub(super) pitch: [f64; 3],
}

impl Grid {
    pub(super) fn layer_count(&self) -> i64 {
        self.steps[2] + 1
    }

    /// Number of struts between all neighbours.
    pub(super) fn strut_count(&self) -> u64 {
        let layers = |step: &[i64; 3]| Parity::of(0..=self.steps[2] - step[2]);
        let of_step =
            |step: &[i64; 3]| layers(step).even * self.pairs(0, step) + layers(step).odd * self.pairs(1, step);
        self.kind.neighbours().iter().map(of_step).sum()
    }

    /// Number of nodes of layer `k` whose neighbour at `step` lies within the grid along x and y.
    fn pairs(&self, k: i64, step: &[i64; 3]) -> u64 {
        let [x, y] = [0, 1].map(|axis| Parity::of((-step[axis]).max(0)..=self.steps[axis] - step[axis].max(0)));
        match (self.kind, k & 1) {
            (Kind::Bcc | Kind::Random, 0) => x.even * y.even,
            (Kind::Bcc | Kind::Random, _) => x.odd * y.odd,
            (Kind::Octet, 0) => x.even * y.even + x.odd * y.odd,
            (Kind::Octet, _) => x.even * y.odd + x.odd * y.even,
        }
    }

    /// A random choice of `wanted` among all struts.
    pub(super) fn choice(&self, wanted: u64) -> Choice {
        Choice { left: self.strut_count(), wanted }
    }

    /// Calls `emit` for the chosen struts whose lower grid node lies in layer `k`. Struts of the next layer begin no lower.
    pub(super) fn layer(&self, k: i64, radii: &Radii, choice: &mut Choice, emit: &mut impl FnMut(Strut)) {
        for j in 0..=self.steps[1] {
            for i in (0..=self.steps[0]).filter(|&i| self.kind.is_node([i, j, k])) {
                let node = self.node([i, j, k]);
                for (number, step) in self.kind.neighbours().iter().enumerate() {
                    let other = moved([i, j, k], *step);
                    if (0..3).any(|axis| !(0..=self.steps[axis]).contains(&other[axis])) {
                        continue;
                    }
                    let chance = mix(node.hash ^ number as u64);
                    if !choice.takes(chance) {
                        continue;
                    }
                    let mut ends = [node.at, self.node(other).at];
                    ends.sort_unstable_by_key(|&node| node_key(node));
                    let [a, b] = ends;
                    let radius = radii.of(unit(mix(chance)));
                    emit(Strut {
                        a,
                        b,
                        radius_a: radius,
                        radius_b: radius,
                        caps: Caps::default(),
                        shares: Shares::default(),
                    });
                }
            }
        }
    }

    /// A node. Nodes of [`Kind::Random`] are moved from their grid points; those on faces of the box stay on these faces.
    fn node(&self, place: [i64; 3]) -> Node {
        let hash = place.iter().fold(self.seed, |state, &value| mix(state ^ value as u64));
        let at = [0, 1, 2].map(|axis| {
            let mut at = place[axis] as f64;
            if self.kind == Kind::Random && place[axis] > 0 && place[axis] < self.steps[axis] {
                at += JITTER * (2.0 * unit(hash.rotate_left(21 * axis as u32)) - 1.0);
            }
            (at * self.pitch[axis]).round() as i32
        });
        Node { at, hash }
    }
}

struct Node {
    at: [i32; 3],
    hash: u64,
}

/// Chooses a given number of struts so that all subsets are equally likely (selection sampling: Fan, Muller & Rezucha 1962; Knuth, The
/// Art of Computer Programming 2, §3.4.2, algorithm S).
#[derive(Clone, Copy, Debug)]
pub(super) struct Choice {
    left: u64,
    wanted: u64,
}

impl Choice {
    /// Whether the next strut is chosen; `chance` is 64 random bits.
    fn takes(&mut self, chance: u64) -> bool {
        let taken = unit(chance) * (self.left as f64) < self.wanted as f64;
        self.left = self.left.saturating_sub(1);
        self.wanted -= u64::from(taken);
        taken
    }
}

/// Number of even and of odd integers in a range.
struct Parity {
    even: u64,
    odd: u64,
}

impl Parity {
    /// Counts a range that begins at 0 or 1. It may be empty.
    fn of(range: std::ops::RangeInclusive<i64>) -> Self {
        let below = |end: i64| ((end + 1).max(0) / 2, end.max(0) / 2);
        let (first, end) = (*range.start(), *range.end() + 1);
        let (from, to) = (below(first), below(end.max(first)));
        Self { even: (to.0 - from.0) as u64, odd: (to.1 - from.1) as u64 }
    }
}

fn moved(place: [i64; 3], step: [i64; 3]) -> [i64; 3] {
    [0, 1, 2].map(|axis| place[axis] + step[axis])
}

/// A number from 0 to below 1, made of the highest 32 bits.
fn unit(bits: u64) -> f64 {
    (bits >> 32) as f64 / (1u64 << 32) as f64
}
