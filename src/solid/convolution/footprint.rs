//! Draws the footprint of a strut in a plane, from one base cell and in `f32`.

use super::cut::{Footprints, down, integer, up};
use super::{ENDLESS, MARGIN, patch};
use crate::solid::Strip;
use crate::solid::vector::{self, BothEnds, LANE, LANES, NoEnd, OneEnd, Stretch, greater, lesser, multiply_add};

/// Rows whose cells are found at once, one for each lane.
const ROWS: usize = LANES;

/// Adds the field of the strut in one lane to a strip.
#[inline(always)]
pub(super) fn draw<const FUSED: bool>(cut: &Footprints, lane: usize, strip: &mut Strip<f32>) {
    let width = cut.last_column[lane] - cut.first_column[lane] + 1;
    if width <= 0 || cut.row_count[lane] <= 0 {
        return;
    }
    let tapered = cut.weight_slope[lane] != 0.0;
    // In a wider footprint it is worth finding the cells of each row. A narrower picture has no room for a patch of three vectors.
    let vectors = if strip.columns() < 2 * LANES { 0 } else { (width as usize).div_ceil(LANES) };
    match (vectors, tapered) {
        (1, _) => draw_patch::<1, FUSED>(cut, lane, strip),
        (2, _) => draw_patch::<2, FUSED>(cut, lane, strip),
        (3, _) => draw_patch::<3, FUSED>(cut, lane, strip),
        (_, false) => draw_rows::<FUSED, false>(cut, lane, strip),
        (_, true) => draw_rows::<FUSED, true>(cut, lane, strip),
    }
}

#[inline(always)]
fn draw_patch<const VECTORS: usize, const FUSED: bool>(cut: &Footprints, lane: usize, strip: &mut Strip<f32>) {
    match (cut.weight_slope[lane] != 0.0, cut.sees_lower[lane] != 0.0, cut.sees_upper[lane] != 0.0) {
        (true, ..) => patch::draw::<VECTORS, FUSED, BothEnds<true>>(cut, lane, strip),
        (_, true, true) => patch::draw::<VECTORS, FUSED, BothEnds<false>>(cut, lane, strip),
        (_, true, false) => patch::draw::<VECTORS, FUSED, OneEnd<false>>(cut, lane, strip),
        (_, false, true) => patch::draw::<VECTORS, FUSED, OneEnd<true>>(cut, lane, strip),
        (_, false, false) => patch::draw::<VECTORS, FUSED, NoEnd<false>>(cut, lane, strip),
    }
}

#[inline(always)]
fn draw_rows<const FUSED: bool, const TAPERED: bool>(cut: &Footprints, lane: usize, strip: &mut Strip<f32>) {
    let (first_row, row_count) = (cut.first_row[lane] as usize, cut.row_count[lane] as usize);
    let mut evaluated = 0;
    for some in (0..row_count).step_by(ROWS) {
        let rows = rows::<FUSED>(cut, lane, some);
        for (row, cells) in strip.rows_mut(first_row + some, (row_count - some).min(ROWS)).enumerate() {
            let vectors = rows.vectors[row] as usize;
            if vectors == 0 {
                continue;
            }
            evaluated += vectors;
            let stretch = Stretch {
                q_base: rows.q[row],
                slope: rows.slope[row],
                curve: cut.curve_x[lane],
                lo_base: rows.lo[row],
                hi_base: rows.hi[row],
                axial: cut.axial_x[lane],
                weight: [cut.weight[lane], cut.weight_slope[lane]],
                first_d: rows.first_i[row],
            };
            let first = rows.first[row] as usize;
            let cells = &mut cells[first..first + vectors * LANES];
            match (rows.sees_lower[row] > 0.0, rows.sees_upper[row] > 0.0) {
                (false, false) => vector::add_strut::<FUSED, NoEnd<TAPERED>>(cells, stretch),
                (true, false) if !TAPERED => vector::add_strut::<FUSED, OneEnd<false>>(cells, stretch),
                (false, true) if !TAPERED => vector::add_strut::<FUSED, OneEnd<true>>(cells, stretch),
                _ => vector::add_strut::<FUSED, BothEnds<TAPERED>>(cells, stretch),
            }
        }
    }
    strip.count_rows(row_count, evaluated * LANES);
    strip.touch(cut.first_column[lane] as usize..cut.last_column[lane] as usize + LANES);
}

/// Eight successive rows.
struct Rows {
    /// First cell within reach, as a column of the strip.
    first: [i32; ROWS],
    /// The same, relative to the base column.
    first_i: [f32; ROWS],
    /// Number of vectors from that cell on; 0 if no cell is within reach.
    vectors: [i32; ROWS],
    q: [f32; ROWS],
    slope: [f32; ROWS],
    lo: [f32; ROWS],
    hi: [f32; ROWS],
    /// Positive if the lower end (the upper end) may be within reach of a cell.
    sees_lower: [f32; ROWS],
    sees_upper: [f32; ROWS],
}

/// Finds the cells within reach on eight rows, beginning `skipped` rows after the first row of the footprint. Without branches, so
/// that it compiles to vector instructions.
#[inline(always)]
fn rows<const FUSED: bool>(cut: &Footprints, lane: usize, skipped: usize) -> Rows {
    let none = [0.0; ROWS];
    let mut rows = Rows {
        first: [0; ROWS],
        first_i: none,
        vectors: [0; ROWS],
        q: none,
        slope: none,
        lo: none,
        hi: none,
        sees_lower: none,
        sees_upper: none,
    };
    let margin = MARGIN as f32;
    let (curve_x, axial_x) = (cut.curve_x[lane], cut.axial_x[lane]);
    let inverse_curve_x = 1.0 / curve_x;
    let inverse_root = inverse_curve_x.sqrt();
    let inverse_axial_x = if axial_x == 0.0 { ENDLESS as f32 } else { 1.0 / axial_x };
    let first_j = cut.first_j[lane] + skipped as i32 as f32;
    let (first_column, first_i) = (cut.first_column[lane], cut.first_i[lane]);
    let last_i = first_i + (cut.last_column[lane] - first_column) as f32;
    for (row, place) in LANE.iter().enumerate() {
        let j = first_j + place;
        let steep = multiply_add::<FUSED>(cut.curve_y[lane], j, cut.slope_y[lane]);
        let q = multiply_add::<FUSED>(-j, steep, cut.q_base[lane]);
        let slope = multiply_add::<FUSED>(cut.curve_xy[lane], j, cut.slope_x[lane]);
        let lo = multiply_add::<FUSED>(-cut.axial_y[lane], j, cut.lo_base[lane]);
        let hi = multiply_add::<FUSED>(-cut.axial_y[lane], j, cut.hi_base[lane]);
        let middle = slope * inverse_curve_x * -0.5;
        let most_q = q - middle * (slope + curve_x * middle);
        let covered = greater(most_q + margin, 0.0).sqrt();
        let half = covered * inverse_root;
        let (one, two) = ((lo - 1.0 - margin) * inverse_axial_x, (hi + 1.0 + margin) * inverse_axial_x);
        // Limited to the footprint, so that rounding cannot lead outside of it.
        let left = lesser(greater(greater(middle - half, lesser(one, two)), first_i), last_i);
        let right = greater(lesser(lesser(middle + half, greater(one, two)), last_i), first_i - 1.0);
        let (first, last) = (up(left), down(right));
        let any = (most_q + margin > 0.0) & (first <= last);
        rows.first[row] = integer(first - first_i) + first_column;
        rows.first_i[row] = first;
        rows.vectors[row] = ((integer(last - first) >> LANES.ilog2()) + 1) & -i32::from(any);
        rows.q[row] = q;
        rows.slope[row] = slope;
        rows.lo[row] = lo;
        rows.hi[row] = hi;
        let (one, two) = (axial_x * first, axial_x * last);
        rows.sees_lower[row] = covered + (lo - lesser(one, two));
        rows.sees_upper[row] = covered - (hi - greater(one, two));
    }
    rows
}
