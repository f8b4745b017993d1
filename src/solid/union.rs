//! The exact union of truncated cones, caps and balls, as the 3MF beam lattice extension 1.2 defines it. Unit of length: micrometres.
//!
//! Each row of pixels is a line. A convex body cuts it in one interval, whose ends are roots of a quadratic. For grey, a pixel is
//! sampled at the centres of 8 × 8 sub-pixels with eight such lines; sub-pixels inside several bodies count once. The quadratics are
//! those of a cone, `|v − t u|² = (r + m t)²`, and of a sphere, with the line inserted.
//!
//! `slice/body/lattice` draws with it if the joint is a union.

use super::block::StrutRecord;
use super::{Block, Cap, Grid, InstructionSet, PixelShape, Plane, Shape, Strip};

/// A point is solid if it lies in any beam or ball.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Union;

/// A beam or ball, in micrometres.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnionStrut {
    pub(super) a: [f64; 3],
    /// Unit vector of the axis; zero for a ball.
    pub(super) u: [f64; 3],
    /// 0 for a ball.
    pub(super) length: f64,
    pub(super) radius: [f64; 2],
    pub(super) caps: [Cap; 2],
}

/// An interval of x. It is empty if the first number is greater.
pub(super) type Interval = [f64; 2];

/// The bits of a cap are above those of a radius, of which there are 30: see [`super::MAX_RADIUS`].
const CAP_SHIFT: u32 = 30;

const CAPS: [Cap; 3] = [Cap::Sphere, Cap::Hemisphere, Cap::Butt];

impl Shape for Union {
    /// One bit for each sub-pixel, eight for each sub-row.
    type Cell = u64;

    /// The radius in quanta, and the cap in the two highest bits.
    fn ends(radii: [u32; 2], caps: [Cap; 2], _is_ball: bool, _quantum: f64) -> [u32; 2] {
        debug_assert!(radii.iter().all(|radius| *radius < 1 << CAP_SHIFT));
        [0, 1].map(|end| radii[end] | (caps[end] as u32) << CAP_SHIFT)
    }

    fn draw<'a>(_: InstructionSet, blocks: impl Iterator<Item = &'a Block>, plane: &Plane, strip: &mut Strip<u64>) {
        let Plane { grid, z, quantum } = plane;
        for block in blocks {
            strip.count(block.len(), 0);
            for at in 0..block.len() {
                let shape = UnionStrut::new(block.get(at), *quantum);
                let Some(range) = shape.row_range(grid, *z, 0.0) else { continue };
                let rows = strip.rows_within(range);
                strip.count(0, usize::from(!rows.is_empty()));
                for row in rows {
                    shape.draw_row(grid, *z, strip, row);
                }
            }
        }
    }
}

impl PixelShape for Union {
    const HALO: usize = 0;

    fn merge_bits(_: InstructionSet, strip: &Strip<u64>, row: usize, first_byte: usize, out: &mut [u8]) {
        let pixels = strip.pixels(row, first_byte * 8).as_chunks::<8>().0;
        for (byte, pixels) in out.iter_mut().zip(pixels) {
            *byte |= pixels.iter().fold(0, |bits, cell| bits << 1 | u8::from(*cell != 0));
        }
    }

    fn merge_coverage(_: InstructionSet, strip: &Strip<u64>, row: usize, first_pixel: usize, out: &mut [u8]) {
        for (grey, cell) in out.iter_mut().zip(strip.pixels(row, first_pixel)) {
            *grey = (*grey).max(coverage(*cell));
        }
    }
}

/// The grey value of a pixel with these of its 64 sub-pixels.
pub(super) fn coverage(sub_pixels: u64) -> u8 {
    ((sub_pixels.count_ones() * 255 + 32) / 64) as u8
}

/// Position of sample `index` of `samples` in a pixel, in pixels from its centre.
pub(super) fn sub_offset(index: u32, samples: u32) -> f64 {
    (f64::from(index) + 0.5) / f64::from(samples) - 0.5
}

pub(super) const EMPTY: Interval = [1.0, 0.0];

impl UnionStrut {
    pub(super) fn new(record: StrutRecord, quantum: f64) -> Self {
        let (a, u, length) = record.axis(quantum);
        let radius = record.ends.map(|end| f64::from(end & ((1 << CAP_SHIFT) - 1)) * quantum);
        let caps = record.ends.map(|end| CAPS[(end >> CAP_SHIFT) as usize % CAPS.len()]);
        Self { a, u, length, radius, caps }
    }

    fn draw_row(&self, grid: &Grid, z: f64, strip: &mut Strip<u64>, row: usize) {
        for sub_row in 0..grid.samples {
            let y = grid.y0 + (strip.grid_row(row) + sub_offset(sub_row, grid.samples)) * grid.dy;
            for interval in self.cut(y - self.a[1], z - self.a[2]) {
                self.fill(interval, grid, sub_row, strip, row);
            }
        }
    }

    /// First and last row of the grid within `margin` of what it may reach in the plane; `None` if it does not reach the plane.
    pub(super) fn row_range(&self, grid: &Grid, z: f64, margin: f64) -> Option<[i32; 2]> {
        let radius = self.radius[0].max(self.radius[1]);
        let (dz, run) = (z - self.a[2], self.u[2] * self.length);
        if dz < run.min(0.0) - radius || dz > run.max(0.0) + radius {
            return None;
        }
        // Only the part of the axis within the larger radius of the plane matters.
        let radius = radius + margin;
        let along = |height: f64| if run == 0.0 { 0.0 } else { (height / run).clamp(0.0, 1.0) * self.length };
        let (from, to) = if run == 0.0 { (0.0, self.length) } else { (along(dz - radius), along(dz + radius)) };
        let (y1, y2) = (self.a[1] + self.u[1] * from, self.a[1] + self.u[1] * to);
        let (low, high) = (y1.min(y2) - radius, y1.max(y2) + radius);
        let (one, two) = ((low - grid.y0) / grid.dy, (high - grid.y0) / grid.dy);
        // One more row on both sides, because sub-rows lie up to half a row from the centre of the row.
        // Numbers beyond i32 saturate: such rows lie outside every picture.
        Some([(one.min(two).floor() as i32).saturating_sub(1), (one.max(two).ceil() as i32).saturating_add(1)])
    }

    /// Intervals of x, measured from `a`, in which the line at (y, z), also from `a`, lies in the cone, the cap at `a` and the cap at `b`.
    pub(super) fn cut(&self, y: f64, z: f64) -> [Interval; 3] {
        if self.length == 0.0 {
            return [ball(y, z, self.radius[0]), EMPTY, EMPTY];
        }
        let [ux, uy, uz] = self.u;
        let g = y * uy + z * uz;
        let body = meet(self.cone(y, z, g), slab(g, ux, 0.0, self.length));
        let at_a = self.cap(0, ball(y, z, self.radius[0]), g);
        let [bx, by, bz] = self.u.map(|x| x * self.length);
        let at_b = self.cap(1, ball(y - by, z - bz, self.radius[1]).map(|x| x + bx), g);
        [body, at_a, at_b]
    }

    fn cap(&self, end: usize, ball: Interval, g: f64) -> Interval {
        match self.caps[end] {
            Cap::Sphere => ball,
            Cap::Butt => EMPTY,
            Cap::Hemisphere if end == 0 => meet(ball, slab(g, self.u[0], f64::NEG_INFINITY, 0.0)),
            Cap::Hemisphere => meet(ball, slab(g, self.u[0], self.length, f64::INFINITY)),
        }
    }

    /// The interval in which `|v|² − t² ≤ (r + m t)²`, with `t = g + u_x·x` and m the change of radius along the axis. If the row is so
    /// nearly parallel to the axis that the quadratic opens downwards, the line cuts the double cone in two half-lines. The half-line
    /// on the side of the body counts.
    fn cone(&self, y: f64, z: f64, g: f64) -> Interval {
        let ux = self.u[0];
        let m = (self.radius[1] - self.radius[0]) / self.length;
        let radius = self.radius[0] + m * g;
        let (second, half_first) = (1.0 - ux * ux * (1.0 + m * m), -ux * (g + m * radius));
        let zeroth = y * y + z * z - g * g - radius * radius;
        let discriminant = half_first * half_first - second * zeroth;
        if second > 0.0 {
            if discriminant < 0.0 {
                return EMPTY;
            }
            let [low, high] = roots(second, half_first, zeroth, discriminant);
            return [low, high];
        }
        let inside = slab(g, ux, 0.0, self.length);
        if second == 0.0 {
            return match half_first {
                0.0 if zeroth <= 0.0 => inside,
                0.0 => EMPTY,
                slope if slope > 0.0 => [f64::NEG_INFINITY, -zeroth / (2.0 * slope)],
                slope => [-zeroth / (2.0 * slope), f64::INFINITY],
            };
        }
        if discriminant <= 0.0 {
            return inside;
        }
        let [low, high] = roots(second, half_first, zeroth, discriminant);
        let sides = [[f64::NEG_INFINITY, low], [high, f64::INFINITY]];
        let length = |side: Interval| {
            let [from, to] = meet(side, inside);
            to - from
        };
        if length(sides[0]) >= length(sides[1]) { sides[0] } else { sides[1] }
    }

    /// Sets the sub-pixels of one sub-row whose centres lie in the interval.
    fn fill(&self, interval: Interval, grid: &Grid, sub_row: u32, strip: &mut Strip<u64>, row: usize) {
        let Some([first, last]) = self.samples(interval, grid) else { return };
        let pixels = first / grid.samples as usize..last / grid.samples as usize + 1;
        for (cell, pixel) in strip.row_mut(row)[pixels.clone()].iter_mut().zip(pixels.clone()) {
            *cell |= sub_pixels(pixel, [first, last], grid.samples as usize) << (sub_row * 8);
        }
        strip.touch(pixels);
    }

    /// The first and the last sample of a row whose centres lie in the interval, counted from the first sample of column 0; `None` if there are none.
    pub(super) fn samples(&self, [from, to]: Interval, grid: &Grid) -> Option<[usize; 2]> {
        if from > to {
            return None;
        }
        let samples = f64::from(grid.samples);
        let sample = |x: f64| ((x + self.a[0] - grid.x0) / grid.dx + 0.5) * samples - 0.5;
        let (one, two) = (sample(from), sample(to));
        let last_sample = (grid.width * grid.samples as usize) as f64 - 1.0;
        let (first, last) = (one.min(two).max(0.0).ceil(), one.max(two).min(last_sample).floor());
        (first <= last).then_some([first as usize, last as usize])
    }
}

/// The samples of a pixel from `first` to `last`, counted from the first sample of column 0, as bits.
pub(super) fn sub_pixels(pixel: usize, [first, last]: [usize; 2], samples: usize) -> u64 {
    let mut bits = (1_u64 << samples) - 1;
    if pixel == first / samples {
        bits &= bits << (first % samples);
    }
    if pixel == last / samples {
        bits &= ((1 << samples) - 1) >> (samples - 1 - last % samples);
    }
    bits
}

/// The two roots of `second·x² + 2·half_first·x + zeroth` in ascending order. One root is computed without subtracting nearly equal
/// numbers, the other from their product (Vieta). `second` is not 0.
fn roots(second: f64, half_first: f64, zeroth: f64, discriminant: f64) -> Interval {
    let sum = -(half_first + discriminant.sqrt().copysign(half_first));
    let one = sum / second;
    let two = if sum == 0.0 { one } else { zeroth / sum };
    [one.min(two), one.max(two)]
}

/// The interval in which |v|² ≤ r².
pub(super) fn ball(y: f64, z: f64, radius: f64) -> Interval {
    let rest = radius * radius - y * y - z * z;
    if rest < 0.0 {
        return EMPTY;
    }
    [-rest.sqrt(), rest.sqrt()]
}

/// The interval in which `low ≤ g + u·x ≤ high`.
pub(super) fn slab(g: f64, u: f64, low: f64, high: f64) -> Interval {
    if u == 0.0 {
        return if low <= g && g <= high { [f64::NEG_INFINITY, f64::INFINITY] } else { EMPTY };
    }
    let (one, two) = ((low - g) / u, (high - g) / u);
    [one.min(two), one.max(two)]
}

pub(super) fn meet(one: Interval, two: Interval) -> Interval {
    [one[0].max(two[0]), one[1].min(two[1])]
}
