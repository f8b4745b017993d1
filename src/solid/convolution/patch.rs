//! A small footprint as a patch of one or two vectors a row: all rows begin at the same column, so that nothing has to be
//! found for a row.

use super::cut::Footprints;
use crate::solid::Strip;
use crate::solid::vector::{LANE, LANES, Point, strut_field};

/// Widest patch, in vectors. Wider footprints are worth finding each row's own cells.
pub(super) const MOST_VECTORS: usize = 2;

/// Adds the field of one lane's strut on `VECTORS` vectors of every row.
#[inline(always)]
pub(super) fn draw<const VECTORS: usize, const TAPERED: bool>(cut: &Footprints, lane: usize, strip: &mut Strip<f32>) {
    let (first_row, row_count) = (cut.first_row[lane] as usize, cut.row_count[lane] as usize);
    // A patch that would stick out on the right begins earlier.
    let wanted = cut.first_column[lane] as usize;
    let first = wanted.min(strip.columns() + LANES - VECTORS * LANES);
    let first_i = cut.first_i[lane] - (wanted - first) as i32 as f32;
    let [mut q, mut slope, mut lo, mut hi] = [[[0.0; LANES]; VECTORS]; 4];
    let (slope_x, curve_x, curve_xy) = (cut.slope_x[lane], cut.curve_x[lane], cut.curve_xy[lane]);
    for vector in 0..VECTORS {
        for cell in 0..LANES {
            let i = first_i + (vector * LANES) as f32 + LANE[cell];
            q[vector][cell] = cut.q_base[lane] - i * (slope_x + curve_x * i);
            slope[vector][cell] = cut.slope_y[lane] + curve_xy * i;
            let moved = cut.axial_x[lane] * i;
            lo[vector][cell] = cut.lo_base[lane] - moved;
            hi[vector][cell] = cut.hi_base[lane] - moved;
        }
    }
    let (curve_y, axial_y) = (cut.curve_y[lane], cut.axial_y[lane]);
    let weight = [cut.weight[lane], cut.weight_slope[lane]];
    let mut j = cut.first_j[lane];
    for cells in strip.rows_mut(first_row, row_count) {
        let cells = cells[first..first + VECTORS * LANES].as_chunks_mut::<LANES>().0;
        for vector in 0..VECTORS {
            for cell in 0..LANES {
                let moved = axial_y * j;
                let point = Point {
                    q: q[vector][cell] - j * (slope[vector][cell] + curve_y * j),
                    lo: lo[vector][cell] - moved,
                    hi: hi[vector][cell] - moved,
                };
                cells[vector][cell] += strut_field::<TAPERED>(point, weight);
            }
        }
        j += 1.0;
    }
    strip.count_rows(row_count, row_count * VECTORS * LANES);
    strip.touch(first, first + VECTORS * LANES);
}
