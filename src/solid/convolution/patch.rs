//! Draws a small footprint as a patch of one to three vectors in each row. All rows begin at the same column, so nothing has to be
//! found for single rows. `footprint` chooses it.

use super::cut::Footprints;
use crate::solid::Strip;
use crate::solid::vector::{Ends, LANE, LANES, Point, multiply_add};

/// Adds the field of the strut in one lane to `VECTORS` vectors of every row.
#[inline(always)]
pub(super) fn draw<const VECTORS: usize, const FUSED: bool, E: Ends>(
    cut: &Footprints,
    lane: usize,
    strip: &mut Strip<f32>,
) {
    let (first_row, row_count) = (cut.first_row[lane] as usize, cut.row_count[lane] as usize);
    // A patch that would extend beyond the right edge begins further left.
    let wanted = cut.first_column[lane] as usize;
    let first = wanted.min(strip.columns() + LANES - VECTORS * LANES);
    let first_i = cut.first_i[lane] - (wanted - first) as i32 as f32;
    let [mut q, mut slope, mut lo, mut hi] = [[[0.0; LANES]; VECTORS]; 4];
    let (slope_x, curve_x, curve_xy) = (cut.slope_x[lane], cut.curve_x[lane], cut.curve_xy[lane]);
    for vector in 0..VECTORS {
        let first_i = first_i + (vector * LANES) as f32;
        for cell in 0..LANES {
            let i = first_i + LANE[cell];
            let along = multiply_add::<FUSED>(curve_x, i, slope_x);
            q[vector][cell] = multiply_add::<FUSED>(-i, along, cut.q_base[lane]);
            slope[vector][cell] = multiply_add::<FUSED>(curve_xy, i, cut.slope_y[lane]);
            lo[vector][cell] = multiply_add::<FUSED>(-cut.axial_x[lane], i, cut.lo_base[lane]);
            hi[vector][cell] = multiply_add::<FUSED>(-cut.axial_x[lane], i, cut.hi_base[lane]);
        }
    }
    let (curve_y, axial_y) = (cut.curve_y[lane], cut.axial_y[lane]);
    let weight = [cut.weight[lane], cut.weight_slope[lane]];
    let mut j = cut.first_j[lane];
    let (cells, stride) = strip.cells_from(first_row, first);
    for row in 0..row_count {
        let cells = cells[row * stride..row * stride + VECTORS * LANES].as_chunks_mut::<LANES>().0;
        for vector in 0..VECTORS {
            for cell in 0..LANES {
                let steep = multiply_add::<FUSED>(curve_y, j, slope[vector][cell]);
                let point = Point {
                    q: multiply_add::<FUSED>(-j, steep, q[vector][cell]),
                    lo: multiply_add::<FUSED>(-axial_y, j, lo[vector][cell]),
                    hi: multiply_add::<FUSED>(-axial_y, j, hi[vector][cell]),
                };
                let field = &mut cells[vector][cell];
                *field = E::plus::<FUSED>(*field, point, weight);
            }
        }
        j += 1.0;
    }
    strip.count_rows(row_count, row_count * VECTORS * LANES);
    strip.touch(first..first + VECTORS * LANES);
}
