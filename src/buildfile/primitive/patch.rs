//! Patches as primitives. `tests/relief/` writes and reads them.
//!
//! ```text
//! 0  u8 × 40 widths, one for each column
//! 40 columns: those of corners (`corners`); then for each corner x, y, z of the direction, u and v, and the factor less 1;
//!    then displacement, seams, lowest z counted from that of the patch before, and height
//! ```
//! All but displacement, seams and height are in zigzag.

use super::Primitive;
use super::columns::{self, Scratch, Unpacked};
use super::corners::{self, CORNER_COLUMNS, Corners};
use crate::buildfile::model::Bounds;
use crate::buildfile::relief::{Corner, FACTOR_FRACTIONS, Patch, Relief};

/// Columns of a corner besides its place.
const OTHER_COLUMNS: usize = 6;

/// Columns of a chunk.
pub(super) const COLUMNS: usize = CORNER_COLUMNS + 3 * OTHER_COLUMNS + 4;

/// Size of a patch in a build file, bytes: the most that large files take in practice.
pub(in crate::buildfile) const EXPECTED_PATCH_BYTES: u64 = 80;

/// A factor of 1.
const ONE: i32 = FACTOR_FRACTIONS as i32;

impl Primitive for Patch {
    type Body = Relief;

    const SCRATCH_BYTES: usize = 2 * size_of::<u32>();
    const CHUNK_PRIMITIVES: usize = 2048;

    fn z_range(&self) -> [i32; 2] {
        self.z
    }

    fn encode(patches: &[Self], out: &mut Unpacked) {
        out.bytes.resize(COLUMNS, 0);
        corners::encode(patches, out);
        let mut column = CORNER_COLUMNS;
        for corner in 0..3 {
            for number in 0..OTHER_COLUMNS {
                let value = |patch: &Self| columns::zigzag(other(&patch.corners[corner])[number]);
                out.bytes[column] = out.add(patches.iter().map(value));
                column += 1;
            }
        }
        out.bytes[column] = out.add(patches.iter().map(|patch| u32::from(patch.displacement)));
        out.bytes[column + 1] = out.add(patches.iter().map(|patch| u32::from(patch.seams)));
        let mut before = 0;
        let low = patches.iter().map(|patch| {
            let step = patch.z[0].wrapping_sub(std::mem::replace(&mut before, patch.z[0]));
            columns::zigzag(step)
        });
        out.bytes[column + 2] = out.add(low);
        out.bytes[column + 3] = out.add(patches.iter().map(|patch| patch.z[1].abs_diff(patch.z[0])));
    }

    fn decode(
        bytes: &[u8],
        count: u32,
        relief: &Relief,
        scratch: &mut Scratch,
        out: &mut Vec<Self>,
    ) -> Result<(), String> {
        let (widths, bytes) = bytes.split_first_chunk::<COLUMNS>().ok_or("it is shorter than a chunk's head")?;
        let first = out.len();
        out.resize(first + count as usize, EMPTY);
        let patches = &mut out[first..];
        let (of_corners, widths) = widths.split_at(CORNER_COLUMNS);
        let (mut bytes, _) = corners::decode(bytes, of_corners, &mut scratch.columns, patches, &ANYWHERE)?;
        let mut before = 0;
        for (number, width) in widths.iter().enumerate() {
            let column = &mut scratch.columns[0];
            bytes = columns::take(bytes, count as usize, *width, column).ok_or("its columns are cut short")?;
            for (patch, value) in patches.iter_mut().zip(column) {
                set(patch, number, *value, &mut before)?;
            }
        }
        if !bytes.is_empty() {
            return Err(format!("{} bytes follow its columns", bytes.len()));
        }
        patches.iter().try_for_each(|patch| check(patch, relief))
    }
}

impl Corners for Patch {
    fn corner(&self, number: usize) -> &[i64; 3] {
        &self.corners[number].at
    }

    fn corner_mut(&mut self, number: usize) -> &mut [i64; 3] {
        &mut self.corners[number].at
    }
}

/// A patch whose numbers are still to be filled in.
const EMPTY: Patch = Patch {
    z: [0; 2],
    corners: [Corner { at: [0; 3], direction: [0; 3], texture: [0; 2], factor: 0 }; 3],
    displacement: 0,
    seams: 0,
};

/// Corners are checked with everything else.
const ANYWHERE: Bounds = Bounds { min: [i32::MIN; 3], max: [i32::MAX; 3] };

/// Fills in the value of a column behind those of corners. `before` is the lowest z of the patch before.
///
/// # Errors
/// A text if it is out of range.
fn set(patch: &mut Patch, column: usize, value: u32, before: &mut i32) -> Result<(), String> {
    let signed = columns::unzigzag(value);
    let out_of_range = |_| format!("{value} is out of range in column {}", CORNER_COLUMNS + column);
    let small = || u8::try_from(value).map_err(out_of_range);
    if let Some(corner) = patch.corners.get_mut(column / OTHER_COLUMNS) {
        match column % OTHER_COLUMNS {
            axis @ 0..3 => corner.direction[axis] = i16::try_from(signed).map_err(out_of_range)?,
            axis @ 3..5 => corner.texture[axis - 3] = signed,
            _ => corner.factor = signed.wrapping_add(ONE),
        }
        return Ok(());
    }
    match column - 3 * OTHER_COLUMNS {
        0 => patch.displacement = small()?,
        1 => patch.seams = small()?,
        2 => {
            *before = before.wrapping_add(signed);
            patch.z = [*before; 2];
        }
        // An overflow leaves it below the lowest z, which is refused.
        _ => patch.z[1] = patch.z[0].wrapping_add_unsigned(value),
    }
    Ok(())
}

/// The numbers of a corner besides its place.
fn other(corner: &Corner) -> [i32; OTHER_COLUMNS] {
    let [x, y, z] = corner.direction.map(i32::from);
    let [u, v] = corner.texture;
    [x, y, z, u, v, corner.factor.wrapping_sub(ONE)]
}

/// # Errors
/// A text if the patch is out of range, or leaves the range of z of the relief.
fn check(patch: &Patch, relief: &Relief) -> Result<(), String> {
    patch.check_range(relief)?;
    if patch.z[0] < relief.z_reach[0] || patch.z[1] > relief.z_reach[1] {
        return Err(format!("{patch:?} leaves the header's range of z, {:?}", relief.z_reach));
    }
    Ok(())
}
