//! The exact union as a field: by how far each pixel's centre lies within the nearest beam or ball. Unit of length: micrometres.
//!
//! The excess of a round cone is its radius less the distance from its axis; beyond an end it is that of the end's ball, or the distance
//! from a flat end. The excess of the union is the greatest of all. It is computed as far as [`MARGIN_PX`] outside the solid: the
//! border is interpolated between neighbouring pixels, so nothing farther out matters. Struts that do not reach the plane are left out.
//!
//! `slice/body/lattice` draws with it; `tests/contours/` compares its borders with the formulas.

use super::union::{EMPTY, Interval, Union, UnionStrut, ball, meet, slab};
use super::{Block, Cap, FieldShape, Grid, InstructionSet, Plane, Shape, Strip};

/// The same solid as [`Union`], as a field.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UnionExcess;

/// Excess at a pixel, micrometres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Excess(f32);

impl Default for Excess {
    fn default() -> Self {
        Self(f32::NEG_INFINITY)
    }
}

/// Pixels outside the solid up to which the excess is exact. Two neighbours are at most one pixel apart; half a pixel is to spare.
const MARGIN_PX: f64 = 1.5;

impl Shape for UnionExcess {
    type Cell = Excess;

    fn ends(radii: [u32; 2], caps: [Cap; 2], is_ball: bool, quantum: f64) -> [u32; 2] {
        Union::ends(radii, caps, is_ball, quantum)
    }

    fn draw<'a>(_: InstructionSet, blocks: impl Iterator<Item = &'a Block>, plane: &Plane, strip: &mut Strip<Excess>) {
        let Plane { grid, z, quantum } = plane;
        let margin = MARGIN_PX * grid.dx.abs().max(grid.dy.abs());
        for block in blocks {
            strip.count(block.len(), 0);
            for at in 0..block.len() {
                let strut = UnionStrut::new(block.get(at), *quantum);
                let Some(range) = strut.row_range(grid, *z, margin) else { continue };
                let rows = strip.rows_within(range);
                strip.count(0, usize::from(!rows.is_empty()));
                for row in rows {
                    strut.draw_excess(grid, *z, margin, strip, row);
                }
            }
        }
    }
}

impl FieldShape for UnionExcess {
    fn excess_um(unit_um: f64, _radius_um: f64) -> f32 {
        unit_um as f32
    }

    fn outside_um(excess_um: f32, pitch_um: f64) -> f32 {
        -(MARGIN_PX * pitch_um) as f32 * excess_um
    }

    fn merge_excess(strip: &Strip<Excess>, row: usize, first_pixel: usize, excess_um: f32, out: &mut [f32]) {
        for (excess, cell) in out.iter_mut().zip(strip.pixels(row, first_pixel)) {
            *excess = excess.max(cell.0 * excess_um);
        }
    }
}

impl UnionStrut {
    /// Raises the cells of a row within `margin` of the strut.
    fn draw_excess(&self, grid: &Grid, z: f64, margin: f64, strip: &mut Strip<Excess>, row: usize) {
        let y = grid.y0 + strip.grid_row(row) * grid.dy - self.a[1];
        let z = z - self.a[2];
        let [from, to] = self.near(y, z, margin);
        if from > to {
            return;
        }
        let column = |x: f64| (x + self.a[0] - grid.x0) / grid.dx;
        let (one, two) = (column(from), column(to));
        let (first, last) = (one.min(two).max(0.0).ceil(), one.max(two).min(grid.width as f64 - 1.0).floor());
        if first > last {
            return;
        }
        let (first, end) = (first as usize, last as usize + 1);
        for (cell, column) in strip.row_mut(row)[first..end].iter_mut().zip(first..) {
            let x = grid.x0 + column as f64 * grid.dx - self.a[0];
            cell.0 = cell.0.max(self.excess([x, y, z]) as f32);
        }
        strip.touch(first..end);
    }

    /// An interval of x, measured from `a`, that contains every point within `margin` of the strut on the line at (y, z).
    fn near(&self, y: f64, z: f64, margin: f64) -> Interval {
        let reach = self.radius[0].max(self.radius[1]) + margin;
        let [ux, uy, uz] = self.u;
        let n2 = uy * uy + uz * uz;
        if self.length == 0.0 {
            return ball(y, z, reach);
        }
        let g = y * uy + z * uz;
        let along = slab(g, ux, -reach, self.length + reach);
        if n2 == 0.0 {
            return if y * y + z * z <= reach * reach { along } else { EMPTY };
        }
        // The squared distance from the axis is k²/n² + n² (x − u_x·g/n²)².
        let k = y * uz - z * uy;
        let rest = reach * reach - k * k / n2;
        if rest < 0.0 {
            return EMPTY;
        }
        let (middle, half) = (ux * g / n2, (rest / n2).sqrt());
        meet([middle - half, middle + half], along)
    }

    /// By how far a point, measured from `a`, lies inside.
    fn excess(&self, v: [f64; 3]) -> f64 {
        let Self { u, length, radius, caps, .. } = *self;
        if length == 0.0 {
            return radius[0] - norm(v);
        }
        let t = v[0] * u[0] + v[1] * u[1] + v[2] * u[2];
        let away = norm([0, 1, 2].map(|axis| v[axis] - t * u[axis]));
        let at_b = || norm([0, 1, 2].map(|axis| v[axis] - length * u[axis]));
        let body = if t < 0.0 {
            beyond(caps[0], radius[0], away, -t, || norm(v))
        } else if t > length {
            beyond(caps[1], radius[1], away, t - length, at_b)
        } else {
            let mut inside = radius[0] + (radius[1] - radius[0]) * (t / length) - away;
            if caps[0] == Cap::Butt {
                inside = inside.min(t);
            }
            if caps[1] == Cap::Butt {
                inside = inside.min(length - t);
            }
            inside
        };
        // The whole ball of an end reaches beyond the cone only if the radii differ, or past a flat other end.
        if radius[0] == radius[1] && !caps.contains(&Cap::Butt) {
            return body;
        }
        let whole = |end: usize, distance: f64| radius[end] - distance;
        let body = if caps[0] == Cap::Sphere { body.max(whole(0, norm(v))) } else { body };
        if caps[1] == Cap::Sphere { body.max(whole(1, at_b())) } else { body }
    }
}

/// The excess at a point `past` an end, `away` from the axis; `distance` is that from the node.
fn beyond(cap: Cap, radius: f64, away: f64, past: f64, distance: impl Fn() -> f64) -> f64 {
    match cap {
        Cap::Sphere | Cap::Hemisphere => radius - distance(),
        Cap::Butt if away <= radius => -past,
        Cap::Butt => -((away - radius) * (away - radius) + past * past).sqrt(),
    }
}

fn norm(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}
