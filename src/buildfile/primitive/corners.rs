//! Columns of the corners of triangles and patches: whole quanta and fractions of a quantum, for z, y, x of each corner.
//!
//! Quanta of the first corner are counted from those of the triangle before it along z, and from 0 along y and x; those of the other two
//! corners from the first. All are in zigzag. `triangle` and `patch` lay out their corners with it.

use super::columns::{self, Unpacked};
use crate::buildfile::model::{Bounds, QUANTUM_FRACTIONS};

/// Columns of corners: quanta and fractions of three coordinates of three corners.
pub(super) const CORNER_COLUMNS: usize = 18;

/// What has three corners.
pub(super) trait Corners {
    /// A corner, in fractions of a quantum.
    fn corner(&self, number: usize) -> &[i64; 3];

    /// As [`Corners::corner`], to be changed.
    fn corner_mut(&mut self, number: usize) -> &mut [i64; 3];
}

/// Adds the columns of corners to a chunk, and their widths to its first bytes.
pub(super) fn encode(all: &[impl Corners], out: &mut Unpacked) {
    for (column, (corner, axis)) in places().enumerate() {
        let mut before = 0;
        let quanta = all.iter().map(|one| {
            let here = whole(one.corner(corner)[axis]);
            let base = if corner > 0 { whole(one.corner(0)[axis]) } else { before };
            before = if axis == 2 { here } else { 0 };
            columns::zigzag(here.wrapping_sub(base))
        });
        out.bytes[2 * column] = out.add(quanta);
        out.bytes[2 * column + 1] = out.add(all.iter().map(|one| fraction(one.corner(corner)[axis])));
    }
}

/// Fills in all corners from the front of `bytes`, whose columns have these widths. Returns what follows, and whether all corners are within
/// the bounds.
///
/// # Errors
/// A text if bytes are missing, or a fraction is no fraction.
pub(super) fn decode<'a>(
    mut bytes: &'a [u8],
    widths: &[u8],
    columns: &mut [Vec<u32>],
    all: &mut [impl Corners],
    bounds: &Bounds,
) -> Result<(&'a [u8], bool), String> {
    let [quanta, fractions, ..] = columns else { return Err("there is no room for columns".into()) };
    let mut is_within = true;
    for ((corner, axis), widths) in places().zip(widths.as_chunks::<2>().0) {
        for (column, width) in [&mut *quanta, &mut *fractions].into_iter().zip(widths) {
            bytes = columns::take(bytes, all.len(), *width, column).ok_or("its columns are cut short")?;
        }
        if fractions.iter().any(|fraction| i64::from(*fraction) >= QUANTUM_FRACTIONS) {
            return Err(format!("a fraction of a quantum is not below {QUANTUM_FRACTIONS}"));
        }
        let place = Place { corner, axis, allowed: [bounds.min[axis], bounds.max[axis]] };
        is_within &= place.fill(all, quanta, fractions);
    }
    Ok((bytes, is_within))
}

/// A coordinate of a corner.
struct Place {
    corner: usize,
    axis: usize,
    /// Lowest and highest value, quanta.
    allowed: [i32; 2],
}

impl Place {
    /// Fills in this coordinate of all corners. Returns whether all values are within what is allowed.
    fn fill(&self, all: &mut [impl Corners], quanta: &[u32], fractions: &[u32]) -> bool {
        let Self { corner, axis, allowed } = *self;
        let [least, most] = allowed.map(|quanta| i64::from(quanta) * QUANTUM_FRACTIONS);
        let mut before = 0_i32;
        // Its sign says whether anything was outside.
        let mut outside = 0_i64;
        for ((one, quanta), fraction) in all.iter_mut().zip(quanta).zip(fractions) {
            let base = if corner > 0 { whole(one.corner(0)[axis]) } else { before };
            let here = columns::unzigzag(*quanta).wrapping_add(base);
            if corner == 0 && axis == 2 {
                before = here;
            }
            let at = i64::from(here) * QUANTUM_FRACTIONS + i64::from(*fraction);
            outside |= (at - least) | (most - at);
            one.corner_mut(corner)[axis] = at;
        }
        outside >= 0
    }
}

/// The quanta of a coordinate, rounded down.
pub(super) fn whole(coordinate: i64) -> i32 {
    coordinate.div_euclid(QUANTUM_FRACTIONS) as i32
}

/// The rest of a coordinate.
fn fraction(coordinate: i64) -> u32 {
    coordinate.rem_euclid(QUANTUM_FRACTIONS) as u32
}

/// Corner and axis of each pair of columns.
fn places() -> impl Iterator<Item = (usize, usize)> {
    (0..9).map(|place| (place / 3, 2 - place % 3))
}
