//! Cuts eight struts with one plane: the result is a quadratic about a base cell for each. `footprint` and `patch` draw from it.

use super::reach::{Reach, Window};
use crate::solid::block::Shares;
use crate::solid::vector::{LANES, greater, lesser};
use crate::solid::{Block, Plane, WHOLE_SHARE};

/// The share of a strut that is of one material.
const WHOLE: f32 = WHOLE_SHARE as f32;

/// Eight struts as seen in a plane, each relative to a base cell. At i columns and j rows from it,
/// `q = q_base − i (slope_x + curve_xy·j + curve_x·i) − j (slope_y + curve_y·j)`, and the ends of the strut are at
/// `lo_base − axial_x·i − axial_y·j` and `hi_base − axial_x·i − axial_y·j` from the foot. This is `q = 1 − |v × u|²` of
/// [`reference`](crate::solid::reference), expanded in i and j. Lengths are in R; rows and columns are those of the strip.
pub(super) struct Footprints {
    /// First row within reach, and number of rows.
    pub(super) first_row: [i32; LANES],
    pub(super) row_count: [i32; LANES],
    /// First and last column within reach, limited to the strip.
    pub(super) first_column: [i32; LANES],
    pub(super) last_column: [i32; LANES],
    /// First column and first row, relative to the base cell.
    pub(super) first_i: [f32; LANES],
    pub(super) first_j: [f32; LANES],
    pub(super) q_base: [f32; LANES],
    pub(super) slope_x: [f32; LANES],
    pub(super) slope_y: [f32; LANES],
    pub(super) curve_x: [f32; LANES],
    pub(super) curve_xy: [f32; LANES],
    pub(super) curve_y: [f32; LANES],
    pub(super) lo_base: [f32; LANES],
    pub(super) hi_base: [f32; LANES],
    pub(super) axial_x: [f32; LANES],
    pub(super) axial_y: [f32; LANES],
    /// 0 if the plane is R or more above the lower end (below the upper end), so that no cell can reach that end; else 1.
    pub(super) sees_lower: [f32; LANES],
    pub(super) sees_upper: [f32; LANES],
    /// Weight at the lower end, and its change per unit of length.
    pub(super) weight: [f32; LANES],
    pub(super) weight_slope: [f32; LANES],
    /// Not 0 if the weight is no linear function, because both radius and share vary.
    pub(super) bow: [f32; LANES],
}

impl Footprints {
    /// Cuts the chosen records of a block. Without branches, so that it compiles to vector instructions.
    #[inline(always)]
    pub(super) fn new(block: &Block, chosen: &[u8; LANES], reach: &Reach, plane: &Plane, window: &Window) -> Self {
        let mut cut = Self::empty();
        let grid = &plane.grid;
        let quantum = plane.quantum;
        let (dx, dy) = (grid.dx, grid.dy);
        let (dx_f32, dy_f32) = (dx as f32, dy as f32);
        let at = chosen;
        let [a_x, a_y, a_z] = [gather(&block.a[0], at), gather(&block.a[1], at), gather(&block.a[2], at)];
        let [b_x, b_y, b_z] = [gather(&block.b[0], at), gather(&block.b[1], at), gather(&block.b[2], at)];
        let [weight_a, weight_b] = [gather(&block.ends[0], at), gather(&block.ends[1], at)];
        let [left, right] = [gather(&reach.left, at), gather(&reach.right, at)];
        let [low, high] = [gather(&reach.low, at), gather(&reach.high, at)];
        for lane in 0..LANES {
            let base_column = nearest((left[lane] + right[lane]) * 0.5);
            let base_row = nearest((low[lane] + high[lane]) * 0.5);
            let (a_x, a_y, a_z) = (f64::from(a_x[lane]), f64::from(a_y[lane]), f64::from(a_z[lane]));
            let (b_x, b_y, b_z) = (f64::from(b_x[lane]), f64::from(b_y[lane]), f64::from(b_z[lane]));
            let (e_x, e_y, e_z) = ((b_x - a_x) * quantum, (b_y - a_y) * quantum, (b_z - a_z) * quantum);
            let length = (e_x * e_x + e_y * e_y + e_z * e_z).sqrt();
            let inverse_length = 1.0 / length;
            let (u_x, u_y, u_z) = (e_x * inverse_length, e_y * inverse_length, e_z * inverse_length);
            // From a to the base cell. h² = |v × u|² is precise for long struts, too.
            let v_x = f64::from(base_column) * dx - (a_x * quantum - grid.x0);
            let v_y = f64::from(base_row) * dy - (a_y * quantum - grid.y0);
            let v_z = plane.z - a_z * quantum;
            let (c_x, c_y, c_z) = (v_y * u_z - v_z * u_y, v_z * u_x - v_x * u_z, v_x * u_y - v_y * u_x);
            let t = v_x * u_x + v_y * u_y + v_z * u_z;
            cut.q_base[lane] = (1.0 - (c_x * c_x + c_y * c_y + c_z * c_z)) as f32;
            cut.slope_x[lane] = (2.0 * dx * (v_x - u_x * t)) as f32;
            cut.slope_y[lane] = (2.0 * dy * (v_y - u_y * t)) as f32;
            cut.lo_base[lane] = -t as f32;
            cut.hi_base[lane] = (length - t) as f32;

            cut.sees_lower[lane] = if v_z < 1.0 { 1.0 } else { 0.0 };
            cut.sees_upper[lane] = if e_z - v_z < 1.0 { 1.0 } else { 0.0 };
            let (u_x, u_y, u_z) = (u_x as f32, u_y as f32, u_z as f32);
            cut.curve_x[lane] = dx_f32 * dx_f32 * (u_y * u_y + u_z * u_z);
            cut.curve_xy[lane] = -2.0 * dx_f32 * dy_f32 * u_x * u_y;
            cut.curve_y[lane] = dy_f32 * dy_f32 * (u_x * u_x + u_z * u_z);
            cut.axial_x[lane] = u_x * dx_f32;
            cut.axial_y[lane] = u_y * dy_f32;
            let (weight_a, weight_b) = (f32::from_bits(weight_a[lane]), f32::from_bits(weight_b[lane]));
            cut.weight[lane] = weight_a;
            cut.weight_slope[lane] = (weight_b - weight_a) * inverse_length as f32;

            let first_row = up(greater(low[lane] - window.first_row, 0.0));
            let last_row = down(lesser(high[lane] - window.first_row, window.row_count - 1.0));
            let first_column = up(greater(left[lane] - window.first_column, 0.0));
            let last_column = down(lesser(right[lane] - window.first_column, window.column_count - 1.0));
            cut.first_row[lane] = integer(first_row);
            cut.row_count[lane] = integer(last_row - first_row + 1.0);
            cut.first_column[lane] = integer(first_column);
            cut.last_column[lane] = integer(last_column);
            cut.first_i[lane] = first_column + (window.first_column - base_column);
            cut.first_j[lane] = first_row + (window.first_row - base_row);
        }
        cut
    }

    /// Reduces the weights to the shares of one material.
    #[inline(always)]
    pub(super) fn share(&mut self, shares: &Shares, chosen: &[u8; LANES]) {
        let [share_a, share_b] = [gather(&shares[0], chosen), gather(&shares[1], chosen)];
        for lane in 0..LANES {
            let [share_a, share_b] = [share_a[lane], share_b[lane]].map(|share| f32::from(share) / WHOLE);
            let (weight, slope, length) =
                (self.weight[lane], self.weight_slope[lane], self.hi_base[lane] - self.lo_base[lane]);
            let (weight_a, weight_b) = (weight * share_a, (weight + slope * length) * share_b);
            self.weight[lane] = weight_a;
            self.weight_slope[lane] = (weight_b - weight_a) / length;
            self.bow[lane] = slope * (share_b - share_a);
        }
    }

    #[inline(always)]
    fn empty() -> Self {
        let (none, zero) = ([0.0; LANES], [0; LANES]);
        Self {
            first_row: zero,
            row_count: zero,
            first_column: zero,
            last_column: zero,
            first_i: none,
            first_j: none,
            q_base: none,
            slope_x: none,
            slope_y: none,
            curve_x: none,
            curve_xy: none,
            curve_y: none,
            lo_base: none,
            hi_base: none,
            axial_x: none,
            axial_y: none,
            sees_lower: none,
            sees_upper: none,
            weight: none,
            weight_slope: none,
            bow: none,
        }
    }
}

/// `array::map` would not be inlined, and so would not be compiled for the instruction set.
#[inline(always)]
fn gather<T: Copy + Default>(column: &[T; Block::LEN], at: &[u8; LANES]) -> [T; LANES] {
    let mut values = [T::default(); LANES];
    for lane in 0..LANES {
        values[lane] = column[usize::from(at[lane]) % Block::LEN];
    }
    values
}

/// 1.5 · 2²³: added and taken away again, it rounds, as an `f32` holds only integers there. It is the middle of an octave, so that
/// sums with both signs stay within it.
const NEAREST_SHIFT: f32 = 12_582_912.0;

/// The nearest whole number, for numbers within ±2²². A cast would not compile to vector instructions.
#[inline(always)]
pub(super) fn nearest(x: f32) -> f32 {
    (x + NEAREST_SHIFT) - NEAREST_SHIFT
}

/// Rounds down, within the same range.
#[inline(always)]
pub(super) fn down(x: f32) -> f32 {
    let rounded = nearest(x);
    rounded - if rounded > x { 1.0 } else { 0.0 }
}

/// Rounds up, within the same range.
#[inline(always)]
pub(super) fn up(x: f32) -> f32 {
    let rounded = nearest(x);
    rounded + if rounded < x { 1.0 } else { 0.0 }
}

/// Converts a whole number within the same range. The result for any other number is arbitrary.
#[inline(always)]
pub(super) fn integer(x: f32) -> i32 {
    ((x + NEAREST_SHIFT).to_bits() as i32).wrapping_sub(NEAREST_SHIFT.to_bits() as i32)
}
