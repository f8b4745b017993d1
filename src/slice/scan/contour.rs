//! Marching squares: where the border of a layer crosses the grid of pixel centres, and how it runs from crossing to crossing.
//!
//! The vertices of the grid are the pixel centres. Around them lies a frame of vertices that are not solid, so every border is closed.
//! An edge between a solid vertex and one that is not is crossed once, where the field, linear along the edge, is 0. On the frame that is
//! in the middle: the border of the area. A saddle is a cell with two solid corners that face each other. They are joined if the field at
//! the centre of the cell is 0 or more; the bilinear field at the centre is the mean of the corners.
//!
//! `field` marches through bands of rows, `join` between them. `tests/contours/` compares the result with the picture's topology.

use super::charged::Charged;
use crate::stream::{BudgetExceeded, MemoryBudget};

/// The direction of an edge of the grid, as the number of its axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Along {
    /// From a column to the next.
    Row = 0,
    /// From a row to the next.
    Column = 1,
}

/// A crossing of the border with an edge of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Crossing {
    /// Column of the lower vertex plus 1: the frame has column 0.
    pub(super) x: u16,
    /// Row of the lower vertex plus 1.
    pub(super) y: u16,
    /// Distance from the lower vertex, in units of the pitch / [`PITCH`]; [`EDGE`] to `PITCH − EDGE`.
    pub(super) at: u16,
    /// Direction of the edge.
    pub(super) along: Along,
    /// Whether the lower vertex is the solid one.
    pub(super) low_is_solid: bool,
}

/// Units of [`Crossing::at`] between two vertices: half a nanometre at a pitch of 30 µm.
pub(super) const PITCH: f64 = 65_536.0;

/// Least distance of a crossing from the vertices, in the units of [`Crossing::at`]: an eighth of a micrometre at a pitch of 30 µm. So
/// borders that pass a pixel's centre on several sides do not touch.
pub(super) const EDGE: u16 = 256;

const MIDDLE: u16 = 1 << 15;

/// Crossings, and for each the next one along the border: the solid lies to the left.
pub(super) struct Chains {
    pub(super) crossings: Charged<Crossing>,
    pub(super) next: Charged<u32>,
}

/// No next crossing yet.
pub(super) const OPEN: u32 = u32::MAX;

/// A row of vertices, and where its crossings are.
#[derive(Clone, Copy)]
pub(super) struct VertexRow<'a> {
    /// Number of the row plus 1.
    pub(super) y: u16,
    /// The field; `None` for the frame.
    pub(super) field: Option<&'a [f32]>,
    /// Bit c is set if the vertex in column c is solid, the frame's included.
    pub(super) solid: &'a [u64],
    /// Number of the first crossing along the row. The others follow, in ascending order of their columns.
    pub(super) first: u32,
}

/// 64-bit words for the vertices of a row, the frame's included.
pub(super) fn words(width_px: usize) -> usize {
    (width_px + 2).div_ceil(64)
}

/// Says which vertices of a row are solid: sets bit i + 1 for pixel i if its field is at least 0.
pub(super) fn find_solid(field: &[f32], solid: &mut [u64]) {
    let mut carry = 0;
    let mut pixels = field.chunks(64);
    for word in solid {
        // Most words have no solid vertex, which eight pixels at a time tell.
        let bits = pixels.next().filter(|pixels| has_solid(pixels)).map_or(0, |pixels| {
            let eights = pixels.chunks(8).rev();
            eights.fold(0_u64, |bits, eight| bits << 8 | u64::from(solid_of_eight(eight)))
        });
        *word = bits << 1 | carry;
        carry = bits >> 63;
    }
}

/// Whether the field is at least 0 at any of the pixels.
fn has_solid(field: &[f32]) -> bool {
    let (eights, rest) = field.as_chunks::<8>();
    let mut highest = [f32::NEG_INFINITY; 8];
    for eight in eights {
        for (highest, excess) in highest.iter_mut().zip(eight) {
            *highest = if *excess > *highest { *excess } else { *highest };
        }
    }
    highest.iter().chain(rest).any(|excess| *excess >= 0.0)
}

#[inline(always)]
fn solid_of_eight(field: &[f32]) -> u8 {
    field.iter().rev().fold(0, |bits, excess| bits << 1 | u8::from(*excess >= 0.0))
}

/// Where the field, linear from one vertex to the next, is 0.
fn zero(low: f32, high: f32) -> u16 {
    let at = f64::from(low) / (f64::from(low) - f64::from(high)) * PITCH;
    // The cast saturates.
    (at.round() as u16).clamp(EDGE, u16::MAX - EDGE + 1)
}

/// The bits of a word, and those of the vertices one column further.
fn with_next(solid: &[u64], word: usize) -> [u64; 2] {
    let next = solid.get(word + 1).copied().unwrap_or(0);
    [solid[word], solid[word] >> 1 | next << 63]
}

/// The sides of a cell, counter-clockwise where x points right and y up.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    South,
    East,
    North,
    West,
}

use Side::{East, North, South, West};

/// From which side to which the border runs, with the solid to the left. Corners are bits: south-west 1, south-east 2, north-east 4,
/// north-west 8. Saddles, and cells without a border, have no entry of their own.
const RUNS: [Option<[Side; 2]>; 16] = {
    let mut runs = [None; 16];
    runs[1] = Some([South, West]);
    runs[2] = Some([East, South]);
    runs[3] = Some([East, West]);
    runs[4] = Some([North, East]);
    runs[6] = Some([North, South]);
    runs[7] = Some([North, West]);
    runs[8] = Some([West, North]);
    runs[9] = Some([South, North]);
    runs[11] = Some([East, North]);
    runs[12] = Some([West, East]);
    runs[13] = Some([South, East]);
    runs[14] = Some([West, South]);
    runs
};

/// The two runs through a saddle. Joined corners are separated from the others by a run around each of these; corners that are not joined
/// have a run around themselves.
fn saddle_runs(south_west_is_solid: bool, joined: bool) -> [[Side; 2]; 2] {
    match (south_west_is_solid, joined) {
        (true, true) => [[South, East], [North, West]],
        (true, false) => [[South, West], [North, East]],
        (false, true) => [[West, South], [East, North]],
        (false, false) => [[East, South], [West, North]],
    }
}

impl Chains {
    /// No crossings.
    pub(super) fn new(budget: &MemoryBudget) -> Self {
        Self { crossings: Charged::new(budget), next: Charged::new(budget) }
    }

    pub(super) fn clear(&mut self) {
        self.crossings.clear();
        self.next.clear();
    }

    fn push(&mut self, crossing: Crossing) -> Result<u32, BudgetExceeded> {
        let number = self.crossings.len() as u32;
        self.crossings.push(crossing)?;
        self.next.push(OPEN)?;
        Ok(number)
    }

    /// Adds the crossings along a row of pixels. Returns the number of the first.
    pub(super) fn push_row(&mut self, y: u16, field: &[f32], solid: &[u64]) -> Result<u32, BudgetExceeded> {
        let first = self.crossings.len() as u32;
        for word in 0..solid.len() {
            let [low, high] = with_next(solid, word);
            let mut changes = low ^ high;
            while changes != 0 {
                let bit = changes.trailing_zeros() as usize;
                changes &= changes - 1;
                let column = word * 64 + bit;
                // Column c is pixel c − 1.
                let at =
                    if column == 0 || column == field.len() { MIDDLE } else { zero(field[column - 1], field[column]) };
                let low_is_solid = low >> bit & 1 != 0;
                self.push(Crossing { x: column as u16, y, at, along: Along::Row, low_is_solid })?;
            }
        }
        Ok(first)
    }

    /// Marches through the cells between two rows, of which `south` is the one with the lower number: adds the crossings with the edges
    /// between the rows, and connects all crossings. `reversed` if one axis of the picture runs against the field's.
    pub(super) fn march(
        &mut self,
        south: &VertexRow<'_>,
        north: &VertexRow<'_>,
        reversed: bool,
    ) -> Result<(), BudgetExceeded> {
        let (mut next_south, mut next_north, mut west) = (south.first, north.first, OPEN);
        for word in 0..south.solid.len() {
            let [sw, se] = with_next(south.solid, word);
            let [nw, ne] = with_next(north.solid, word);
            let mut cells = (sw ^ se) | (nw ^ ne) | (sw ^ nw) | (se ^ ne);
            while cells != 0 {
                let bit = cells.trailing_zeros();
                cells &= cells - 1;
                let is_solid = [sw, se, ne, nw].map(|corners| corners >> bit & 1 != 0);
                let column = word * 64 + bit as usize;
                let crossings = [
                    if is_solid[0] != is_solid[1] { take(&mut next_south) } else { OPEN },
                    if is_solid[1] != is_solid[2] {
                        self.push_between(south, north, column + 1, is_solid[1])?
                    } else {
                        OPEN
                    },
                    if is_solid[2] != is_solid[3] { take(&mut next_north) } else { OPEN },
                    west,
                ];
                west = crossings[East as usize];
                let corners = is_solid.iter().rev().fold(0, |bits, solid| bits << 1 | usize::from(*solid));
                if let Some(run) = RUNS[corners] {
                    self.connect(crossings, run, reversed);
                } else if let (Some(low), Some(high)) = (south.field, north.field)
                    && is_solid[0] != is_solid[1]
                {
                    let centre = (low[column - 1] + high[column]) + (low[column] + high[column - 1]);
                    for run in saddle_runs(is_solid[0], centre >= 0.0) {
                        self.connect(crossings, run, reversed);
                    }
                }
            }
        }
        Ok(())
    }

    /// Adds the crossing with the edge between two rows in a column, the frame's being 0.
    fn push_between(
        &mut self,
        south: &VertexRow<'_>,
        north: &VertexRow<'_>,
        column: usize,
        low_is_solid: bool,
    ) -> Result<u32, BudgetExceeded> {
        let at = match (south.field, north.field) {
            (Some(low), Some(high)) => zero(low[column - 1], high[column - 1]),
            _ => MIDDLE,
        };
        self.push(Crossing { x: column as u16, y: south.y, at, along: Along::Column, low_is_solid })
    }

    fn connect(&mut self, crossings: [u32; 4], [from, to]: [Side; 2], reversed: bool) {
        let (from, to) = (crossings[from as usize], crossings[to as usize]);
        let (from, to) = if reversed { (to, from) } else { (from, to) };
        self.next[from as usize] = to;
    }
}

fn take(next: &mut u32) -> u32 {
    *next += 1;
    *next - 1
}
