//! The pixels of a plane, and strips: a few rows of cells to draw on.
//!
//! `slice/body/lattice/brush.rs` has one strip for each thread, and draws the bands of a layer on it one after another.

use std::ops::Range;

use super::MAX_MATERIALS;

/// Positions of pixel centres: column i at `x0 + i·dx`, row j at `y0 + j·dy`. Pitches are negative if the picture is mirrored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Grid {
    /// x of column 0.
    pub(crate) x0: f64,
    /// Distance from one column to the next.
    pub(crate) dx: f64,
    /// y of row 0.
    pub(crate) y0: f64,
    /// Distance from one row to the next.
    pub(crate) dy: f64,
    /// Number of columns.
    pub(crate) width: usize,
    /// Samples along each side of a pixel, for shapes that are sampled: 1 for bits, 8 for grey.
    pub(crate) samples: u32,
}

/// A plane to be drawn, in the unit of length of the solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plane {
    /// Its pixels.
    pub(crate) grid: Grid,
    /// Its height.
    pub(crate) z: f64,
    /// Length of the quantum of the struts.
    pub(crate) quantum: f64,
}

/// Columns that share one `touched` flag: eight bytes of a picture of bits.
const BLOCK: usize = 64;

/// Spare cells at the end of each row, because a kernel may write a whole vector that begins at the last pixel.
const SPARE: usize = super::vector::LANES;

/// Counters of the work that drawing took, for benchmarks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effort {
    /// Struts looked at. Each band looks at the struts that may reach it at any height.
    pub looks: u64,
    /// Struts that reached the band in the plane. A strut that reaches two bands counts twice.
    pub drawn: u64,
    /// Rows of footprints drawn. A row of a long strut counts once for each 64 cells. 0 for a union.
    pub rows: u64,
    /// Fields evaluated, in whole vectors. 0 for a union.
    pub evaluations: u64,
}

impl std::iter::Sum for Effort {
    fn sum<I: Iterator<Item = Self>>(each: I) -> Self {
        each.fold(Self::default(), |sum, one| Self {
            looks: sum.looks + one.looks,
            drawn: sum.drawn + one.drawn,
            rows: sum.rows + one.rows,
            evaluations: sum.evaluations + one.evaluations,
        })
    }
}

/// Unused entries before and after the flags in [`Strip::touched`]. They keep the flags of two threads on different cache lines, which
/// have at most 128 bytes and are fetched in pairs: a line that two threads write moves back and forth between them.
const APART: usize = 256;

/// Some rows of cells, with `halo` more columns on each side than the grid has.
///
/// Aligned so that the counters of two threads never share a cache line.
#[derive(Debug)]
#[repr(align(256))]
pub(crate) struct Strip<Cell> {
    cells: Vec<Cell>,
    stride: usize,
    halo: usize,
    first_row: i32,
    rows: usize,
    /// For each block of [`BLOCK`] columns, whether any cell may differ from the default; [`APART`] more entries before and after.
    touched: Vec<bool>,
    /// Work since the strip was made.
    effort: Effort,
}

impl<Cell: Copy + Default> Strip<Cell> {
    /// A strip for up to `rows` rows of `width` pixels, with `halo` more on every side.
    pub(crate) fn new(width: usize, rows: usize, halo: usize) -> Self {
        let stride = Self::stride(width, halo);
        let cells = vec![Cell::default(); stride * (rows + 2 * halo)];
        let touched = vec![false; stride.div_ceil(BLOCK) + 2 * APART];
        Self { cells, stride, halo, first_row: 0, rows: 0, touched, effort: Effort::default() }
    }

    /// Memory of a strip, bytes.
    pub(crate) fn bytes(width: usize, rows: usize, halo: usize) -> u64 {
        (Self::stride(width, halo) * (rows + 2 * halo) * size_of::<Cell>()) as u64
    }

    fn stride(width: usize, halo: usize) -> usize {
        width + 2 * halo + SPARE
    }

    /// Clears the strip and assigns rows `first_row .. first_row + rows` of the grid to it, plus halo rows.
    pub(crate) fn begin(&mut self, first_row: usize, rows: usize) {
        for range in runs(&self.touched[APART..], self.stride) {
            for row in self.cells.chunks_exact_mut(self.stride) {
                row[range.clone()].fill(Cell::default());
            }
        }
        self.touched.fill(false);
        self.rows = rows + 2 * self.halo;
        debug_assert!(self.rows * self.stride <= self.cells.len());
        self.first_row = i32::try_from(first_row).unwrap_or(i32::MAX) - self.halo as i32;
    }

    /// The rows of this strip within a range of the grid's rows, counted from the first halo row.
    pub(super) fn rows_within(&self, [first, last]: [i32; 2]) -> Range<usize> {
        let first = (first.saturating_sub(self.first_row)).max(0) as usize;
        let end = (last.saturating_sub(self.first_row).saturating_add(1)).max(0) as usize;
        first..end.min(self.rows)
    }

    /// Number of rows, including halo rows.
    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    /// Row number in the grid of a row of this strip.
    pub(super) fn grid_row(&self, row: usize) -> f64 {
        f64::from(self.first_row) + row as f64
    }

    /// Column number in the grid of the first cell.
    pub(super) fn first_column(&self) -> f64 {
        -(self.halo as f64)
    }

    /// Cells in a row, without the spare ones.
    pub(super) fn columns(&self) -> usize {
        self.stride - SPARE
    }

    /// The cells of one row, including the spare ones.
    pub(super) fn row_mut(&mut self, row: usize) -> &mut [Cell] {
        &mut self.cells[row * self.stride..(row + 1) * self.stride]
    }

    /// Successive rows of cells. `chunks_exact_mut` would begin with a division.
    #[inline(always)]
    pub(super) fn rows_mut(&mut self, first: usize, count: usize) -> impl Iterator<Item = &mut [Cell]> {
        self.cells[first * self.stride..(first + count) * self.stride].chunks_mut(self.stride)
    }

    /// The cells from a given one on, row after row, and the distance from one row to the next.
    #[inline(always)]
    pub(super) fn cells_from(&mut self, row: usize, column: usize) -> (&mut [Cell], usize) {
        (&mut self.cells[row * self.stride + column..], self.stride)
    }

    /// Begins as one of `strips`, and fills each row of cells that any of them has touched with what `join` makes of theirs. All have the same size.
    pub(crate) fn join<'a>(&mut self, strips: &[&'a Self], mut join: impl FnMut(&[&'a [Cell]], &mut [Cell])) {
        let Some(first) = strips.first() else { return };
        // Outside of what is written below, the cells must be those of an empty strip.
        self.begin(0, first.rows - 2 * self.halo);
        self.first_row = first.first_row;
        for strip in strips {
            self.touched.iter_mut().zip(&strip.touched).for_each(|(touched, other)| *touched |= other);
        }
        let mut cells: [&[Cell]; MAX_MATERIALS] = [&[]; MAX_MATERIALS];
        for columns in runs(&self.touched[APART..], self.stride) {
            for row in 0..self.rows {
                let columns = row * self.stride + columns.start..row * self.stride + columns.end;
                for (cells, strip) in cells.iter_mut().zip(strips) {
                    *cells = &strip.cells[columns.clone()];
                }
                join(&cells[..strips.len()], &mut self.cells[columns]);
            }
        }
    }

    /// The cells of pixels of a row, a whole number of vectors, which may include spare ones. `row` is counted from the first row of the band.
    pub(crate) fn some_pixels(&self, row: usize, pixels: Range<usize>) -> &[Cell] {
        &self.pixels(row, pixels.start)[..pixels.len()]
    }

    /// Marks a range of columns as written. The range is not empty.
    #[inline(always)]
    pub(super) fn touch(&mut self, cells: Range<usize>) {
        let (first, last) = (APART + cells.start / BLOCK, APART + (cells.end.min(self.stride) - 1) / BLOCK);
        (self.touched[first], self.touched[last]) = (true, true);
        if last - first > 1 {
            self.touched[first + 1..last].fill(true);
        }
    }

    /// Counts struts that were looked at, and those of them that were drawn.
    pub(super) fn count(&mut self, looks: usize, drawn: usize) {
        self.effort.looks += looks as u64;
        self.effort.drawn += drawn as u64;
    }

    /// Counts rows of footprints, and the fields evaluated on them.
    #[inline(always)]
    pub(super) fn count_rows(&mut self, rows: usize, evaluations: usize) {
        self.effort.rows += rows as u64;
        self.effort.evaluations += evaluations as u64;
    }

    /// Work since the strip was made.
    pub(crate) fn effort(&self) -> Effort {
        self.effort
    }

    /// Ranges of pixels, in ascending order. Outside of them all cells have the default.
    pub(crate) fn used_pixels(&self, width: usize) -> impl Iterator<Item = Range<usize>> {
        // Cell c is pixel c − halo. The coverage of a pixel depends on cells within the halo.
        let before = 2 * self.halo;
        let pixels = runs(&self.touched[APART..], self.stride);
        pixels.map(move |cells| cells.start.saturating_sub(before).min(width)..cells.end.min(width))
    }

    /// As [`Strip::used_pixels`], of any of several strips of the same size.
    pub(crate) fn used_together(strips: &[&Self], width: usize) -> Vec<Range<usize>> {
        let Some(first) = strips.first() else { return Vec::new() };
        let flags = &first.touched[APART..];
        let together = |block: usize| strips.iter().any(|strip| strip.touched[APART + block]);
        let touched: Vec<bool> = (0..flags.len()).map(together).collect();
        let before = 2 * first.halo;
        let pixels = runs(&touched, first.stride);
        pixels.map(|cells| cells.start.saturating_sub(before).min(width)..cells.end.min(width)).collect()
    }

    /// The cells of a row from a pixel on, including the spare ones. `row` is counted from the first row of the band.
    pub(super) fn pixels(&self, row: usize, first: usize) -> &[Cell] {
        let row = row + self.halo;
        &self.cells[row * self.stride + self.halo + first..(row + 1) * self.stride]
    }

    /// The cells of the row above, the row itself and the row below, from the one left of a pixel on. Only for strips with a halo.
    pub(super) fn around(&self, row: usize, first: usize) -> [&[Cell]; 3] {
        [0, 1, 2].map(|line| &self.cells[(row + line) * self.stride + first..(row + line + 1) * self.stride])
    }
}

/// The columns of all touched blocks in rows of `stride` cells, as few ranges as possible.
fn runs(touched: &[bool], stride: usize) -> impl Iterator<Item = Range<usize>> {
    let mut first = 0;
    touched[..stride.div_ceil(BLOCK)].chunk_by(|one, other| one == other).filter_map(move |run| {
        let blocks = first..first + run.len();
        first = blocks.end;
        run[0].then(|| blocks.start * BLOCK..(blocks.end * BLOCK).min(stride))
    })
}
