//! Thresholds for halftones: blue noise, whose pixels above any threshold are evenly distributed without a pattern (void and cluster, Ulichney 1993).
//!
//! The mask is made of whole numbers, so it is the same on every machine. It is repeated over the rows and columns of a layer. From layer to layer each
//! threshold moves on by the golden ratio, so every column of pixels has its shares, too. A threshold depends on column, row and layer alone.
//!
//! `tests/materials/halftone.rs` measures how evenly shares are distributed.

use std::sync::LazyLock;

/// Rows and columns of the mask.
const SIDE: usize = 64;
const CELLS: usize = SIDE * SIDE;

/// Bits of a rank: all of them are different.
const RANK_BITS: u32 = CELLS.ilog2();

/// `2³²/φ`: multiples of the golden ratio modulo 1 are evenly distributed, however many there are.
const GOLDEN: u32 = 2_654_435_769;

/// How far a cell makes itself felt: farther away less than a thousandth of its influence is left.
const REACH: usize = 7;

/// `e^(−1/(2σ²))` in 2³²nds, for σ = 1.9 pixels: by this factor the influence of a cell falls for each unit of the squared distance.
const FALL: u64 = 3_739_454_652;

/// The rank of each cell, row by row.
static RANKS: LazyLock<Vec<u16>> = LazyLock::new(ranks);

/// The thresholds of one layer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Halftone {
    turn: u32,
}

impl Halftone {
    /// Thresholds after which a row repeats itself.
    pub(crate) const PERIOD: usize = SIDE;

    /// The thresholds of a layer.
    pub(crate) fn of_layer(layer: u32) -> Self {
        Self { turn: layer.wrapping_mul(GOLDEN) }
    }

    /// The thresholds of columns 0 to 63 of a row, above 0 and below 1.
    pub(crate) fn row(&self, row: usize) -> [f32; SIDE] {
        let ranks = &RANKS[row % SIDE * SIDE..][..SIDE];
        let mut thresholds = [0.0; SIDE];
        for (threshold, rank) in thresholds.iter_mut().zip(ranks) {
            // The middle of what belongs to the rank.
            let middle = u32::from(*rank) << (32 - RANK_BITS) | 1 << (31 - RANK_BITS);
            // Exact in an `f32`, and neither 0 nor 1.
            let bits = middle.wrapping_add(self.turn) >> 9;
            *threshold = (bits as f32 + 0.5) * (1.0 / (1 << 23) as f32);
        }
        thresholds
    }
}

/// A pattern of cells, and how near others are to each cell.
struct Pattern {
    is_set: Vec<bool>,
    crowd: Vec<u64>,
    influence: Vec<[u64; 2 * REACH + 1]>,
}

impl Pattern {
    fn empty() -> Self {
        let mut fall = vec![1_u64 << 32];
        for squared in 0..2 * REACH * REACH {
            fall.push((fall[squared] * FALL) >> 32);
        }
        let at = |dy: usize, dx: usize| fall[dy.abs_diff(REACH).pow(2) + dx.abs_diff(REACH).pow(2)];
        let influence = (0..=2 * REACH).map(|dy| std::array::from_fn(|dx| at(dy, dx))).collect();
        Self { is_set: vec![false; CELLS], crowd: vec![0; CELLS], influence }
    }

    /// Sets a cell, or takes it away.
    fn toggle(&mut self, cell: usize) {
        self.is_set[cell] = !self.is_set[cell];
        let (row, column) = (cell / SIDE, cell % SIDE);
        for (dy, influence) in self.influence.iter().enumerate() {
            let row = (row + dy + SIDE - REACH) % SIDE * SIDE;
            for (dx, influence) in influence.iter().enumerate() {
                let crowd = &mut self.crowd[row + (column + dx + SIDE - REACH) % SIDE];
                *crowd = if self.is_set[cell] { *crowd + influence } else { *crowd - influence };
            }
        }
    }

    /// The cell of the set ones that has most others near it.
    fn tightest_cluster(&self) -> usize {
        // Of several the first.
        let set = (0..CELLS).rev().filter(|cell| self.is_set[*cell]);
        set.max_by_key(|cell| self.crowd[*cell]).unwrap_or(0)
    }

    /// The cell of those not set that has fewest set ones near it.
    fn largest_void(&self) -> usize {
        let free = (0..CELLS).filter(|cell| !self.is_set[*cell]);
        free.min_by_key(|cell| self.crowd[*cell]).unwrap_or(0)
    }
}

/// Cells of the first pattern: a tenth, as Ulichney has it.
const FIRST_CELLS: usize = CELLS / 10;

fn ranks() -> Vec<u16> {
    let mut pattern = Pattern::empty();
    // Any pattern would do. This one is even to begin with (multiples of the golden ratio), so few cells move.
    for number in 0..FIRST_CELLS as u64 {
        let place = ((number * u64::from(GOLDEN) * CELLS as u64) >> 32) as usize % CELLS;
        let free = (place..place + CELLS).map(|cell| cell % CELLS).find(|cell| !pattern.is_set[*cell]);
        pattern.toggle(free.unwrap_or(place));
    }
    loop {
        let cluster = pattern.tightest_cluster();
        pattern.toggle(cluster);
        let void = pattern.largest_void();
        pattern.toggle(void);
        if void == cluster {
            break;
        }
    }
    let mut ranks = vec![0; CELLS];
    let mut first =
        Pattern { is_set: pattern.is_set.clone(), crowd: pattern.crowd.clone(), influence: pattern.influence.clone() };
    for rank in (0..FIRST_CELLS).rev() {
        let cluster = first.tightest_cluster();
        first.toggle(cluster);
        ranks[cluster] = rank as u16;
    }
    for rank in FIRST_CELLS..CELLS {
        let void = pattern.largest_void();
        pattern.toggle(void);
        ranks[void] = rank as u16;
    }
    ranks
}
