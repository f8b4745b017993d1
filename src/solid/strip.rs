//! The pixels of a plane, and a few rows of them to draw on.

use std::ops::Range;

/// Where pixel centres lie: column i at `x0 + i·dx`, row j at `y0 + j·dy`. Pitches are negative where mirrored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Column 0.
    pub x0: f64,
    /// From one column to the next.
    pub dx: f64,
    /// Row 0.
    pub y0: f64,
    /// From one row to the next.
    pub dy: f64,
    /// Number of columns.
    pub width: usize,
    /// Samples along each side of a pixel, for shapes that are sampled: 1, or 8 for grey.
    pub samples: u32,
}

/// The plane that is drawn, in a solid's unit of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Its pixels.
    pub grid: Grid,
    /// Its height.
    pub z: f64,
    /// Length of the quantum in which struts are given.
    pub quantum: f64,
}

/// Columns that are noted as touched together: eight bytes of a picture of bits.
const BLOCK: usize = 64;

/// Spare cells at the end of each row: a kernel may write a whole vector that begins at the last pixel.
const SPARE: usize = super::vector::LANES;

/// What drawing took, for those who ask what bounds it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effort {
    /// Looks at struts; each band looks at those that may reach it at some height.
    pub looks: u64,
    /// Of those, struts that reached the band in this plane; one that reaches two bands counts twice.
    pub drawn: u64,
    /// Rows of footprints drawn, those of long struts once for each 64 cells; 0 of a union.
    pub rows: u64,
    /// Fields evaluated, whole vectors counted; 0 of a union.
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

/// Unused entries before and after those of [`Strip::touched`]. They keep the lists of two threads on different cache lines (at
/// most 128 bytes, fetched in pairs): a line that two threads write moves back and forth between them.
const APART: usize = 256;

/// Some rows of cells, `halo` more columns on each side than the grid has.
///
/// Aligned so that the counters of no two threads' strips share a cache line.
#[derive(Debug)]
#[repr(align(256))]
pub struct Strip<Cell> {
    cells: Vec<Cell>,
    stride: usize,
    halo: usize,
    first_row: i32,
    rows: usize,
    /// In which blocks of [`BLOCK`] columns any row may hold anything but the default; [`APART`] more before and after.
    touched: Vec<bool>,
    /// Since the strip was made.
    effort: Effort,
}

impl<Cell: Copy + Default> Strip<Cell> {
    /// A strip for up to `rows` rows of `width` pixels, with `halo` more on every side.
    pub fn new(width: usize, rows: usize, halo: usize) -> Self {
        let stride = Self::stride(width, halo);
        let cells = vec![Cell::default(); stride * (rows + 2 * halo)];
        let touched = vec![false; stride.div_ceil(BLOCK) + 2 * APART];
        Self { cells, stride, halo, first_row: 0, rows: 0, touched, effort: Effort::default() }
    }

    /// Bytes a strip takes.
    pub fn bytes(width: usize, rows: usize, halo: usize) -> u64 {
        (Self::stride(width, halo) * (rows + 2 * halo) * size_of::<Cell>()) as u64
    }

    fn stride(width: usize, halo: usize) -> usize {
        width + 2 * halo + SPARE
    }

    /// Clears the strip and lets it stand for rows `first_row .. first_row + rows` of the grid, halo rows besides.
    pub fn begin(&mut self, first_row: usize, rows: usize) {
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

    /// The part of a row range that lies in this strip, counted from its first row (halo rows included).
    pub(super) fn rows_within(&self, [first, last]: [i32; 2]) -> Range<usize> {
        let first = (first.saturating_sub(self.first_row)).max(0) as usize;
        let end = (last.saturating_sub(self.first_row).saturating_add(1)).max(0) as usize;
        first..end.min(self.rows)
    }

    /// Rows the strip stands for, halo rows included.
    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    /// The grid's row number of a row of this strip.
    pub(super) fn grid_row(&self, row: usize) -> f64 {
        f64::from(self.first_row) + row as f64
    }

    /// The grid's column number of the first cell.
    pub(super) fn first_column(&self) -> f64 {
        -(self.halo as f64)
    }

    /// Cells a row without the spare ones.
    pub(super) fn columns(&self) -> usize {
        self.stride - SPARE
    }

    /// One row of cells, spare ones included.
    pub(super) fn row_mut(&mut self, row: usize) -> &mut [Cell] {
        &mut self.cells[row * self.stride..(row + 1) * self.stride]
    }

    /// Successive rows of cells. Not `chunks_exact`, which begins with a division.
    #[inline(always)]
    pub(super) fn rows_mut(&mut self, first: usize, count: usize) -> impl Iterator<Item = &mut [Cell]> {
        self.cells[first * self.stride..(first + count) * self.stride].chunks_mut(self.stride)
    }

    /// The cells from one on, row after row, and how many there are from one row to the next.
    #[inline(always)]
    pub(super) fn cells_from(&mut self, row: usize, column: usize) -> (&mut [Cell], usize) {
        (&mut self.cells[row * self.stride + column..], self.stride)
    }

    /// Notes that cells of some rows were written; the range is not empty.
    #[inline(always)]
    pub(super) fn touch(&mut self, cells: Range<usize>) {
        let (first, last) = (APART + cells.start / BLOCK, APART + (cells.end.min(self.stride) - 1) / BLOCK);
        (self.touched[first], self.touched[last]) = (true, true);
        if last - first > 1 {
            self.touched[first + 1..last].fill(true);
        }
    }

    /// Counts looks at struts, and those of them that were drawn.
    pub(super) fn count(&mut self, looks: usize, drawn: usize) {
        self.effort.looks += looks as u64;
        self.effort.drawn += drawn as u64;
    }

    /// Counts rows of a strut and the fields evaluated on them.
    #[inline(always)]
    pub(super) fn count_rows(&mut self, rows: usize, evaluations: usize) {
        self.effort.rows += rows as u64;
        self.effort.evaluations += evaluations as u64;
    }

    /// What drawing has taken since the strip was made.
    pub fn effort(&self) -> Effort {
        self.effort
    }

    /// Ranges of pixels, ascending, outside of which every row has the default.
    pub fn used_pixels(&self, width: usize) -> impl Iterator<Item = Range<usize>> {
        // Cell c is pixel c − halo; a pixel's coverage hangs on cells up to the halo away.
        let before = 2 * self.halo;
        let pixels = runs(&self.touched[APART..], self.stride);
        pixels.map(move |cells| cells.start.saturating_sub(before).min(width)..cells.end.min(width))
    }

    /// The cells of a row from a pixel on, spare ones included; `row` counts from the band's first.
    pub(super) fn pixels(&self, row: usize, first: usize) -> &[Cell] {
        let row = row + self.halo;
        &self.cells[row * self.stride + self.halo + first..(row + 1) * self.stride]
    }

    /// The cells above a row, of it and below it, from the one left of a pixel on. Only for strips with a halo.
    pub(super) fn around(&self, row: usize, first: usize) -> [&[Cell]; 3] {
        [0, 1, 2].map(|line| &self.cells[(row + line) * self.stride + first..(row + line + 1) * self.stride])
    }
}

/// The cells of a row of `stride` cells whose blocks are touched, in as few ranges as possible.
fn runs(touched: &[bool], stride: usize) -> impl Iterator<Item = Range<usize>> {
    let mut first = 0;
    touched[..stride.div_ceil(BLOCK)].chunk_by(|one, other| one == other).filter_map(move |run| {
        let blocks = first..first + run.len();
        first = blocks.end;
        run[0].then(|| blocks.start * BLOCK..(blocks.end * BLOCK).min(stride))
    })
}
