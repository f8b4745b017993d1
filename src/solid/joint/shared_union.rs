//! The exact union of struts of which a part may be of another material. A pixel that several materials cover gets the last of them, as the last beam
//! prevails in 3MF, as far as it is of that material; the rest goes to the one before, and so on. `tests/materials/` tests it.

use super::{JoinedShape, Joining};
use crate::solid::union::{Union, UnionStrut, coverage, sub_offset, sub_pixels};
use crate::solid::{Block, Cap, Grid, InstructionSet, PixelShape, Plane, Shape, Strip};

/// As [`Union`], and the share of one material.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SharedUnion;

/// Content of a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Covered {
    /// Its sub-pixels, as in a [`Union`].
    sub_pixels: u64,
    /// The greatest share of any strut that covers one of them.
    share: f32,
}

impl Shape for SharedUnion {
    type Cell = Covered;

    fn ends(radii: [u32; 2], caps: [Cap; 2], is_ball: bool, quantum: f64) -> [u32; 2] {
        Union::ends(radii, caps, is_ball, quantum)
    }

    fn draw<'a>(_: InstructionSet, blocks: impl Iterator<Item = &'a Block>, plane: &Plane, strip: &mut Strip<Covered>) {
        let Plane { grid, z, quantum } = plane;
        for block in blocks {
            strip.count(block.len(), 0);
            for at in 0..block.len() {
                let record = block.get(at);
                let shares = record.shares();
                let strut = UnionStrut::new(record, *quantum);
                let Some(range) = strut.row_range(grid, *z, 0.0) else { continue };
                let rows = strip.rows_within(range);
                strip.count(0, usize::from(!rows.is_empty()));
                for row in rows {
                    draw_row(&strut, shares, grid, *z, strip, row);
                }
            }
        }
    }
}

fn draw_row(strut: &UnionStrut, shares: [f32; 2], grid: &Grid, z: f64, strip: &mut Strip<Covered>, row: usize) {
    let grid_row = strip.grid_row(row);
    // At the pixel's centre, measured along the axis from `a`.
    let middle = [grid.y0 + grid_row * grid.dy - strut.a[1], z - strut.a[2]];
    for sub_row in 0..grid.samples {
        let y = grid.y0 + (grid_row + sub_offset(sub_row, grid.samples)) * grid.dy;
        for interval in strut.cut(y - strut.a[1], z - strut.a[2]) {
            let Some([first, last]) = strut.samples(interval, grid) else { continue };
            let samples = grid.samples as usize;
            let pixels = first / samples..last / samples + 1;
            let cells = &mut strip.row_mut(row)[pixels.clone()];
            for (cell, column) in cells.iter_mut().zip(pixels.clone()) {
                cell.sub_pixels |= sub_pixels(column, [first, last], samples) << (sub_row * 8);
                let x = grid.x0 + column as f64 * grid.dx - strut.a[0];
                cell.share = cell.share.max(share_at(strut, shares, [x, middle[0], middle[1]]));
            }
            strip.touch(pixels);
        }
    }
}

/// The share at the nearest point of the axis.
fn share_at(strut: &UnionStrut, shares: [f32; 2], v: [f64; 3]) -> f32 {
    if shares[0] == shares[1] {
        return shares[0];
    }
    let along = v[0] * strut.u[0] + v[1] * strut.u[1] + v[2] * strut.u[2];
    let share = (along / strut.length).clamp(0.0, 1.0) as f32;
    shares[0] + share * (shares[1] - shares[0])
}

impl PixelShape for SharedUnion {
    const HALO: usize = 0;

    fn merge_bits(_: InstructionSet, strip: &Strip<Covered>, row: usize, first_byte: usize, out: &mut [u8]) {
        let pixels = strip.pixels(row, first_byte * 8).as_chunks::<8>().0;
        for (byte, pixels) in out.iter_mut().zip(pixels) {
            *byte |= pixels.iter().fold(0, |bits, cell| bits << 1 | u8::from(cell.sub_pixels != 0));
        }
    }

    fn merge_coverage(_: InstructionSet, strip: &Strip<Covered>, row: usize, first_pixel: usize, out: &mut [u8]) {
        for (grey, cell) in out.iter_mut().zip(strip.pixels(row, first_pixel)) {
            *grey = (*grey).max(coverage(cell.sub_pixels));
        }
    }
}

impl JoinedShape for SharedUnion {
    fn join(_: InstructionSet, _: &Joining, cells: &[&[Covered]], out: &mut [Covered]) {
        for (place, out) in out.iter_mut().enumerate() {
            out.sub_pixels = cells.iter().fold(0, |bits, cells| bits | cells[place].sub_pixels);
        }
    }

    #[inline(always)]
    fn solid(_: &Joining, cells: &[&[Covered]], first: usize) -> u8 {
        let is_covered = |pixel: usize| cells.iter().any(|cells| cells[first + pixel].sub_pixels != 0);
        (0..8).fold(0, |bits, pixel| bits << 1 | u8::from(is_covered(pixel)))
    }

    #[inline(always)]
    fn weigh(cells: &[&[Covered]], first: usize, weights: &mut [[f32; 8]]) {
        for pixel in 0..8 {
            let mut left = 1.0_f32;
            for (weights, cells) in weights.iter_mut().zip(cells).rev() {
                weights[pixel] = cells[first + pixel].share.min(left);
                left -= weights[pixel];
            }
        }
    }
}
