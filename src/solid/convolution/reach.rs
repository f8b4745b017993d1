//! Selects the struts of a block that may reach a band of rows in a plane, and bounds their cells. It is fast, in `f32`, and never too
//! narrow.

use crate::solid::vector::{LANES, greater, lesser};
use crate::solid::{Block, Plane, Strip};

/// Added to the support on all sides, for rounding errors in q and in t.
const MARGIN: f32 = super::MARGIN as f32;

/// Added on all sides, for rounding errors of columns and rows, which are below 2¹⁶.
const MARGIN_PX: f32 = 0.02;

/// Length in R beyond which `f32` is too coarse for where the plane meets a strut.
const MAX_LENGTH: f32 = 64.0;

/// A strut is nearly horizontal if its rise is less than its length divided by this. For such struts and for balls the ellipse that the
/// plane cuts from the endless strut is too long to be a useful bound.
const FLAT: f32 = 32.0;

/// Footprints up to this width and height, in R, are drawn from one base cell in `f32`: no term of the quadratic exceeds 16, so q is
/// correct to some 10⁻⁶. In a lattice of struts some 5 R long nearly all footprints are this small.
const COMPACT: f32 = 8.0;

/// A strut counts as parallel to the rows if the square of the sine of its angle with them is below this. Finding the cells of a row
/// divides by it, which must not magnify the rounding errors of `f32` beyond the margin.
const ALONG_ROWS: f32 = 0.05;

/// Replaces 1/0.
const ENDLESS: f32 = super::ENDLESS as f32;

/// Room for the indices of all records of a block, and for the lanes after the last one. A power of two, so that no index needs a
/// check.
pub(super) const CHOSEN: usize = 2 * Block::LEN;

/// The cells that the struts of a block may reach. Columns and rows are those of the grid, not rounded.
pub(super) struct Reach {
    pub(super) left: [f32; Block::LEN],
    pub(super) right: [f32; Block::LEN],
    pub(super) low: [f32; Block::LEN],
    pub(super) high: [f32; Block::LEN],
    /// 1 if the strut can be drawn from one base cell. If 0, the bounds are not reliable and [`super::line`] finds its own.
    pub(super) compact: [f32; Block::LEN],
    seen: [f32; Block::LEN],
}

/// The cells of the grid that a strip holds.
#[derive(Clone, Copy)]
pub(super) struct Window {
    pub(super) first_row: f32,
    pub(super) row_count: f32,
    pub(super) first_column: f32,
    pub(super) column_count: f32,
}

impl Window {
    pub(super) fn of(strip: &Strip<f32>) -> Self {
        Self {
            first_row: strip.grid_row(0) as f32,
            row_count: strip.rows() as f32,
            first_column: strip.first_column() as f32,
            column_count: strip.columns() as f32,
        }
    }
}

impl Reach {
    #[inline(always)]
    pub(super) fn empty() -> Self {
        let none = [0.0; Block::LEN];
        Self { left: none, right: none, low: none, high: none, compact: none, seen: none }
    }

    /// Examines all records of a block. Writes the indices of those that may reach the window to `chosen`, in order, and returns their
    /// number.
    #[inline(always)]
    pub(super) fn look(&mut self, block: &Block, plane: &Plane, window: &Window, chosen: &mut [u8; CHOSEN]) -> usize {
        let count = block.len();
        for first in (0..count).step_by(LANES) {
            self.look_at_lanes(block, first, plane, window);
        }
        let mut found = 0;
        for (at, seen) in self.seen[..count].iter().enumerate() {
            chosen[found % CHOSEN] = at as u8;
            found += usize::from(*seen != 0.0);
        }
        found
    }

    /// Without branches, so that it compiles to vector instructions.
    #[inline(always)]
    fn look_at_lanes(&mut self, block: &Block, first: usize, plane: &Plane, window: &Window) {
        let grid = &plane.grid;
        let (to_columns, to_rows) = (plane.quantum / grid.dx, plane.quantum / grid.dy);
        let (column_0, row_0) = (grid.x0 / grid.dx, grid.y0 / grid.dy);
        let (per_column, per_row) = ((1.0 / grid.dx) as f32, (1.0 / grid.dy) as f32);
        let per_cell = per_column.abs() + per_row.abs();
        let quantum = plane.quantum as f32;
        let (reach_x, reach_y) =
            ((1.0 + MARGIN) * per_column.abs() + MARGIN_PX, (1.0 + MARGIN) * per_row.abs() + MARGIN_PX);
        let [a_x, a_y, a_z] = [lanes(&block.a[0], first), lanes(&block.a[1], first), lanes(&block.a[2], first)];
        let [b_x, b_y, b_z] = [lanes(&block.b[0], first), lanes(&block.b[1], first), lanes(&block.b[2], first)];
        let Window { first_row, row_count, first_column, column_count } = *window;
        let (last_row, last_column) = (first_row + row_count - 1.0, first_column + column_count - 1.0);
        let mut seen_lanes = [[0.0; LANES]; 6];
        for lane in 0..LANES {
            let (a_x, a_y, a_z) = (f64::from(a_x[lane]), f64::from(a_y[lane]), f64::from(a_z[lane]));
            let (b_x, b_y, b_z) = (f64::from(b_x[lane]), f64::from(b_y[lane]), f64::from(b_z[lane]));
            let x = (a_x * to_columns - column_0) as f32;
            let y = (a_y * to_rows - row_0) as f32;
            let dz = (plane.z - a_z * plane.quantum) as f32;
            let e_x = (b_x - a_x) as f32 * quantum;
            let e_y = (b_y - a_y) as f32 * quantum;
            let e_z = (b_z - a_z) as f32 * quantum;
            let (x2, y2, z2) = (e_x * e_x, e_y * e_y, e_z * e_z);
            let length2 = x2 + y2 + z2;
            let is_long = length2 > MAX_LENGTH * MAX_LENGTH;

            // The part of the axis within R of the plane (all of it if the strut is long), extended by R to all sides ...
            let rise = 1.0 / greater(e_z, 1.0 / ENDLESS);
            let from = lesser(greater((dz - 1.0 - MARGIN) * rise, 0.0), 1.0);
            let to = greater(lesser((dz + 1.0 + MARGIN) * rise, 1.0), 0.0);
            let (from, to) = (if is_long { 0.0 } else { from }, if is_long { 1.0 } else { to });
            let (run_x, run_y) = (e_x * per_column, e_y * per_row);
            let (x_from, x_to) = (x + run_x * from, x + run_x * to);
            let (y_from, y_to) = (y + run_y * from, y + run_y * to);
            // ... but no more than the ellipse that the plane cuts from the endless strut.
            let no_bound = is_long | (z2 * (FLAT * FLAT) <= length2);
            let middle = dz * rise;
            let (half_x, half_y) = ((x2 + z2).sqrt() * rise * reach_x, (y2 + z2).sqrt() * rise * reach_y);
            let (half_x, half_y) = (if no_bound { ENDLESS } else { half_x }, if no_bound { ENDLESS } else { half_y });
            let middle = if no_bound { 0.0 } else { middle };
            let (centre_x, centre_y) = (x + run_x * middle, y + run_y * middle);
            let left = greater(lesser(x_from, x_to) - reach_x, centre_x - half_x);
            let right = lesser(greater(x_from, x_to) + reach_x, centre_x + half_x);
            let low = greater(lesser(y_from, y_to) - reach_y, centre_y - half_y);
            let high = lesser(greater(y_from, y_to) + reach_y, centre_y + half_y);

            // Rounding error of the ends of a long strut.
            let rounded = (length2 * 1e-12).sqrt();
            let slack = if is_long { rounded } else { 0.0 };
            let slack_px = slack * per_cell;
            let in_rows = (high + slack_px >= first_row) & (low - slack_px <= last_row);
            let in_columns = (right + slack_px >= first_column) & (left - slack_px <= last_column);
            let in_height = (dz >= -1.0 - MARGIN - slack) & (dz - e_z <= 1.0 + MARGIN + slack);
            let small = (right - left <= COMPACT * per_column.abs()) & (high - low <= COMPACT * per_row.abs());
            let is_across = y2 + z2 >= ALONG_ROWS * length2;
            let compact = small & !is_long & is_across & (length2 > 0.0);
            let seen = in_rows & in_columns & in_height;
            seen_lanes[0][lane] = left;
            seen_lanes[1][lane] = right;
            seen_lanes[2][lane] = low;
            seen_lanes[3][lane] = high;
            seen_lanes[4][lane] = if compact { 1.0 } else { 0.0 };
            seen_lanes[5][lane] = if seen { 1.0 } else { 0.0 };
        }
        let Self { left, right, low, high, compact, seen } = self;
        for (column, lanes) in [left, right, low, high, compact, seen].into_iter().zip(&seen_lanes) {
            column[first..first + LANES].copy_from_slice(lanes);
        }
    }
}

#[inline(always)]
fn lanes(column: &[i32; Block::LEN], first: usize) -> [i32; LANES] {
    let mut values = [0; LANES];
    values.copy_from_slice(&column[first..first + LANES]);
    values
}
