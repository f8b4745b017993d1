//! Draws any strut or ball row by row. The values that a row shares are computed in `f64`, for eight rows at a time.

use super::{ENDLESS, MARGIN, greater, lesser, reciprocal, whole};
use crate::solid::block::StrutRecord;
use crate::solid::vector::{self, BothEnds, LANES, NoEnd, Stretch};
use crate::solid::{Plane, Strip};

/// A strut or ball, with everything that does not depend on the plane. Unit of length: R.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConvolutionStrut {
    a: [f64; 3],
    /// Unit vector of the axis; zero for a ball.
    u: [f64; 3],
    /// 0 for a ball.
    length: f64,
    /// Weight at `a`, and its change per unit of length.
    weight: [f32; 2],
    /// Of a strut whose radius and share both vary: the weight at t is greater than the linear one by `bow · t (t − length)`.
    bow: f32,
}

/// Longest stretch that is evaluated from one base pixel. It limits |d|, and with it the rounding errors of `lo` and `hi`.
const STRETCH_PX: f64 = 64.0;

impl ConvolutionStrut {
    /// Prepares a record of a block.
    pub(super) fn new(record: StrutRecord, plane: &Plane) -> Self {
        let (a, u, length) = record.axis(plane.quantum);
        let [whole_a, whole_b] = record.ends.map(f32::from_bits);
        let [share_a, share_b] = record.shares();
        let (weight_a, weight_b) = (whole_a * share_a, whole_b * share_b);
        if length == 0.0 {
            return Self { a, u, length, weight: [weight_a, 0.0], bow: 0.0 };
        }
        let per_length = 1.0 / length as f32;
        let change = (weight_b - weight_a) * per_length;
        let bow = (whole_b - whole_a) * (share_b - share_a) * per_length * per_length;
        Self { a, u, length, weight: [weight_a, change], bow }
    }

    /// Adds the field to a strip.
    #[inline(always)]
    pub(super) fn draw<const FUSED: bool>(&self, plane: &Plane, strip: &mut Strip<f32>) {
        if let Some(range) = self.row_range(plane) {
            let rows = strip.rows_within(range);
            Line::new(self, plane, strip).draw_rows::<FUSED>(strip, rows);
        }
    }

    /// First and last row of the grid that it may reach.
    fn row_range(&self, Plane { grid, z, .. }: &Plane) -> Option<[i32; 2]> {
        // The part of the axis within R of the plane, extended by R to both sides.
        let dz = z - self.a[2];
        let inverse = reciprocal(self.u[2]);
        let (one, two) = ((dz - 1.0) * inverse, (dz + 1.0) * inverse);
        let (from, to) = (one.min(two).max(0.0), one.max(two).min(self.length));
        if from > to || (self.u[2] == 0.0 && dz.abs() > 1.0) {
            return None;
        }
        let (y1, y2) = (self.a[1] + self.u[1] * from, self.a[1] + self.u[1] * to);
        let (low, high) = (y1.min(y2) - 1.0 - MARGIN, y1.max(y2) + 1.0 + MARGIN);
        let (one, two) = ((low - grid.y0) / grid.dy, (high - grid.y0) / grid.dy);
        // Numbers beyond i32 saturate: such rows lie outside every picture.
        Some([one.min(two).floor() as i32, one.max(two).ceil() as i32])
    }
}

/// A strut in a plane and grid: everything that does not change from row to row.
struct Line<'a> {
    shape: &'a ConvolutionStrut,
    is_ball: bool,
    y0: f64,
    dy: f64,
    /// x of the first cell of the strip, measured from `a`.
    x0: f64,
    dx: f64,
    inverse_dx: f64,
    dz: f64,
    /// Along a row, h² = `least_h2 + n2·(x − middle)²` with n2 = u_y² + u_z², which is 1 for a ball.
    n2: f64,
    inverse_n2: f64,
    inverse_n: f64,
    inverse_ux: f64,
    /// Second-order change of h² per pixel, and change of t per pixel.
    curve: f32,
    axial: f32,
}

/// Rows whose intervals are computed at once.
const ROWS: usize = 8;

/// A strut on eight successive rows: for each row the stretch of cells within reach, and the values of its [`Stretch`].
struct Rows {
    /// First cell, and the one after the last. If there is no cell, `end` is not greater than `first`.
    first: [f64; ROWS],
    end: [f64; ROWS],
    /// The cell after the last one within reach on the row: `end`, or beyond it if the stretch is too long for one base pixel.
    row_end: [f64; ROWS],
    q_base: [f32; ROWS],
    slope: [f32; ROWS],
    lo_base: [f32; ROWS],
    hi_base: [f32; ROWS],
    first_d: [f32; ROWS],
    /// Not negative if every cell is so far from both ends that the strut may be treated as endless.
    beyond_kernel: [f64; ROWS],
}

impl<'a> Line<'a> {
    #[inline(always)]
    fn new(shape: &'a ConvolutionStrut, plane: &Plane, strip: &Strip<f32>) -> Self {
        let grid = &plane.grid;
        let [ux, uy, uz] = shape.u;
        let is_ball = shape.length == 0.0;
        let n2 = if is_ball { 1.0 } else { uy * uy + uz * uz };
        Self {
            shape,
            is_ball,
            y0: grid.y0 - shape.a[1],
            dy: grid.dy,
            x0: grid.x0 + strip.first_column() * grid.dx - shape.a[0],
            dx: grid.dx,
            inverse_dx: 1.0 / grid.dx,
            dz: plane.z - shape.a[2],
            n2,
            inverse_n2: if n2 > 0.0 { 1.0 / n2 } else { 0.0 },
            inverse_n: if n2 > 0.0 { 1.0 / n2.sqrt() } else { ENDLESS },
            inverse_ux: reciprocal(ux),
            curve: (grid.dx * grid.dx * n2) as f32,
            axial: (ux * grid.dx) as f32,
        }
    }

    #[inline(always)]
    fn draw_rows<const FUSED: bool>(&self, strip: &mut Strip<f32>, rows: std::ops::Range<usize>) {
        for some in rows.clone().step_by(ROWS) {
            let mut skipped = 0.0;
            let mut goes_on = true;
            while goes_on {
                goes_on = false;
                let seen = self.rows(strip, some, skipped);
                for row in some..rows.end.min(some + ROWS) {
                    let lane = row - some;
                    self.draw_row::<FUSED>(strip, row, &seen, lane);
                    goes_on |= seen.row_end[lane] > seen.end[lane];
                }
                skipped += STRETCH_PX;
            }
        }
    }

    /// Finds the stretches that begin `skipped` cells after the first cell within reach. Without branches, so that it compiles to
    /// vector instructions.
    ///
    /// With v = (x, y, z) measured from `a`, t = u_x·x + g with g = u_y·y + u_z·z. h² = |v × u|² has its minimum k²/n² at x = u_x·g/n²,
    /// with k = y·u_z − z·u_y and n² = u_y² + u_z².
    #[inline(always)]
    fn rows(&self, strip: &Strip<f32>, row: usize, skipped: f64) -> Rows {
        let [ux, uy, uz] = self.shape.u;
        let length = self.shape.length;
        let first_y = self.y0 + strip.grid_row(row) * self.dy;
        let last_column = strip.columns() as f64 - 1.0;
        // For a row parallel to the strut, and for a ball, the axis is a point.
        let is_point = self.is_ball || self.n2 == 0.0;
        let (slab_low, slab_high) =
            if self.is_ball { (-ENDLESS, ENDLESS) } else { (-1.0 - MARGIN, length + 1.0 + MARGIN) };
        let mut seen = Rows {
            first: [0.0; ROWS],
            end: [0.0; ROWS],
            row_end: [0.0; ROWS],
            q_base: [0.0; ROWS],
            slope: [0.0; ROWS],
            lo_base: [0.0; ROWS],
            hi_base: [0.0; ROWS],
            first_d: [0.0; ROWS],
            beyond_kernel: [0.0; ROWS],
        };
        for lane in 0..ROWS {
            let y = first_y + lane as f64 * self.dy;
            let (k, g) = (y * uz - self.dz * uy, y * uy + self.dz * uz);
            let least_h2 = if is_point { y * y + self.dz * self.dz } else { k * k * self.inverse_n2 };
            let reach = 1.0 + MARGIN - least_h2;
            // Half the length of axis that the kernel covers, at the point of the row nearest to the axis.
            let covered = greater(reach, 0.0).sqrt();
            let (half, middle) = (covered * self.inverse_n, ux * g * self.inverse_n2);
            let (one, two) = ((slab_low - g) * self.inverse_ux, (slab_high - g) * self.inverse_ux);
            let left = greater(middle - half, lesser(one, two));
            let right = lesser(middle + half, greater(one, two));
            let (one, two) = ((left - self.x0) * self.inverse_dx, (right - self.x0) * self.inverse_dx);
            let (low, high) = if self.dx > 0.0 { (one, two) } else { (two, one) };
            // The first whole cell after the lower limit. A cell exactly on the limit is in the margin and contributes 0.
            let first = whole(lesser(greater(low, -1.0), last_column) + 1.0) + skipped;
            let row_end = whole(lesser(greater(high, -1.0), last_column) + 1.0);
            let row_end = if reach > 0.0 { row_end } else { 0.0 };
            let end = lesser(row_end, first + STRETCH_PX);
            seen.first[lane] = first;
            seen.end[lane] = end;
            seen.row_end[lane] = row_end;

            // The base is a cell next to the point nearest to the axis; q decreases away from it.
            let nearest = lesser((middle - self.x0) * self.inverse_dx, end - 1.0);
            let base = whole(greater(nearest, first));
            let x = self.x0 + base * self.dx;
            let (away, lo) = (x - middle, -(g + ux * x));
            seen.q_base[lane] = (1.0 - least_h2 - self.n2 * away * away) as f32;
            seen.slope[lane] = (2.0 * self.dx * self.n2 * away) as f32;
            seen.lo_base[lane] = lo as f32;
            seen.hi_base[lane] = (length + lo) as f32;
            seen.first_d[lane] = (first - base) as f32;

            let (one, two) = (g + ux * (self.x0 + first * self.dx), g + ux * (self.x0 + end * self.dx));
            seen.beyond_kernel[lane] = lesser(lesser(one, two), length - greater(one, two)) - covered;
        }
        seen
    }

    #[inline(always)]
    fn draw_row<const FUSED: bool>(&self, strip: &mut Strip<f32>, row: usize, seen: &Rows, lane: usize) {
        let (first, end) = (seen.first[lane], seen.end[lane]);
        if first >= end {
            return;
        }
        let (first, end) = (first as i32 as usize, end as i32 as usize);
        let stretch = Stretch {
            q_base: seen.q_base[lane],
            slope: seen.slope[lane],
            curve: self.curve,
            lo_base: seen.lo_base[lane],
            hi_base: seen.hi_base[lane],
            axial: self.axial,
            weight: self.shape.weight,
            first_d: seen.first_d[lane],
        };
        let padded = first + (end - first).next_multiple_of(LANES);
        let cells = &mut strip.row_mut(row)[first..padded];
        match (self.is_ball, seen.beyond_kernel[lane] >= 0.0, self.shape.weight[1] != 0.0) {
            (true, ..) => vector::add_ball::<FUSED>(cells, stretch),
            (_, true, true) => vector::add_strut::<FUSED, NoEnd<true>>(cells, stretch),
            (_, true, false) => vector::add_strut::<FUSED, NoEnd<false>>(cells, stretch),
            (_, false, true) => vector::add_strut::<FUSED, BothEnds<true>>(cells, stretch),
            (_, false, false) => vector::add_strut::<FUSED, BothEnds<false>>(cells, stretch),
        }
        if self.shape.bow != 0.0 {
            vector::add_bow::<FUSED>(&mut strip.row_mut(row)[first..padded], stretch, self.shape.bow);
        }
        strip.touch(first..padded);
        strip.count_rows(1, padded - first);
    }
}
