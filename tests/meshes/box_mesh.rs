//! The triangles of a box.

/// Corners of each side, counter-clockwise seen from outside. Bits 0, 1 and 2 of a corner's number say whether it is high along x, y and z.
pub(crate) const SIDES: [[usize; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// A corner of a box, by its number.
pub(crate) fn corner<T: Copy>(number: usize, low: [T; 3], high: [T; 3]) -> [T; 3] {
    [0, 1, 2].map(|axis| if number >> axis & 1 == 0 { low } else { high }[axis])
}

/// The twelve triangles, by the numbers of their corners.
pub(crate) fn box_triangles() -> impl Iterator<Item = [usize; 3]> {
    SIDES.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
}
