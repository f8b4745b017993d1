//! Triangles as primitives. `tests/pack_mesh` writes and reads them; the unit tests of `sort` and `store/chunker.rs` use them, too.
//!
//! ```text
//! 0  u8 × 18 widths, one for each column
//! 18 columns: for each corner, and for z, y, x of each: whole quanta, then fractions of a quantum (20 bits)
//! ```
//! Quanta of the first corner are counted from those of the triangle before it along z, and from 0 along y and x; those of the other two
//! corners from the first. All are in zigzag.

use super::columns::{self, Scratch, Unpacked};
use super::{Key, Primitive};
use crate::buildfile::model::{QUANTUM_FRACTIONS, Surface, Triangle, corner_key};

/// Columns of a chunk: quanta and fractions of three coordinates of three corners.
const COLUMNS: usize = 18;

/// Size of a triangle in a build file, bytes: the most that large files take in practice.
pub(in crate::buildfile) const EXPECTED_TRIANGLE_BYTES: u64 = 40;

/// z, y and x of each corner, their sign bits inverted, so that unsigned order is signed order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::buildfile) struct TriangleKey([u64; 9]);

impl Key for TriangleKey {
    const BYTES: usize = 72;

    const END: Self = Self([u64::MAX; 9]);

    fn append_to(self, bytes: &mut Vec<u8>) {
        self.0.iter().for_each(|word| bytes.extend_from_slice(&word.to_le_bytes()));
    }

    fn from_bytes(bytes: &[u8]) -> Self {
        let (words, rest) = bytes.as_chunks();
        assert!(words.len() == 9 && rest.is_empty(), "a record of {} bytes", bytes.len());
        Self(std::array::from_fn(|word| u64::from_le_bytes(words[word])))
    }
}

impl Primitive for Triangle {
    type Key = TriangleKey;
    type Body = Surface;

    const SCRATCH_BYTES: usize = COLUMNS * size_of::<u32>();

    fn key(&self) -> TriangleKey {
        let words = self.corners.map(corner_key);
        TriangleKey(std::array::from_fn(|word| words[word / 3][word % 3] as u64 ^ 1 << 63))
    }

    fn of_key(TriangleKey(words): &TriangleKey) -> Self {
        let value = |word: usize| (words[word] ^ 1 << 63) as i64;
        // `corner_key` turns a corner around, and back.
        Self { corners: [0, 3, 6].map(|word| corner_key([value(word), value(word + 1), value(word + 2)])) }
    }

    fn z_range(&self) -> [i32; 2] {
        let bounds = self.bounds();
        [bounds.min[2], bounds.max[2]]
    }

    fn encode(triangles: &[Self], out: &mut Unpacked) {
        out.bytes.resize(COLUMNS, 0);
        for (column, (corner, axis)) in places().enumerate() {
            let mut before = 0;
            let quanta = triangles.iter().map(|triangle| {
                let here = whole(triangle.corners[corner][axis]);
                let base = if corner > 0 { whole(triangle.corners[0][axis]) } else { before };
                before = if axis == 2 { here } else { 0 };
                columns::zigzag(here.wrapping_sub(base))
            });
            out.bytes[2 * column] = out.add(quanta);
            out.bytes[2 * column + 1] =
                out.add(triangles.iter().map(|triangle| fraction(triangle.corners[corner][axis])));
        }
    }

    fn decode(
        bytes: &[u8],
        count: u32,
        surface: &Surface,
        scratch: &mut Scratch,
        out: &mut Vec<Self>,
    ) -> Result<(), String> {
        let (widths, mut bytes) = bytes.split_first_chunk::<COLUMNS>().ok_or("it is shorter than a chunk's head")?;
        for (column, width) in scratch.columns.iter_mut().zip(widths) {
            bytes = columns::take(bytes, count as usize, *width, column).ok_or("its columns are cut short")?;
        }
        if !bytes.is_empty() {
            return Err(format!("{} bytes follow its columns", bytes.len()));
        }
        let mut before = 0_i32;
        for number in 0..count as usize {
            let mut corners = [[0; 3]; 3];
            let mut first = [0, 0, before];
            for (column, (corner, axis)) in places().enumerate() {
                let quanta = columns::unzigzag(scratch.columns[2 * column][number]).wrapping_add(first[axis]);
                if corner == 0 {
                    first[axis] = quanta;
                }
                let part = i64::from(scratch.columns[2 * column + 1][number]);
                corners[corner][axis] = i64::from(quanta) * QUANTUM_FRACTIONS + part;
            }
            before = first[2];
            let triangle = Self { corners };
            check(&triangle, surface)?;
            out.push(triangle);
        }
        Ok(())
    }
}

/// # Errors
/// A text if the triangle does not begin with its lowest corner, or leaves the bounds of the surface.
fn check(triangle: &Triangle, surface: &Surface) -> Result<(), String> {
    triangle.check_range()?;
    if Triangle::new(triangle.corners) != *triangle {
        return Err(format!("{triangle:?} does not begin with its lowest corner"));
    }
    let (found, allowed) = (triangle.bounds(), &surface.bounds);
    if (0..3).any(|axis| found.min[axis] < allowed.min[axis] || found.max[axis] > allowed.max[axis]) {
        return Err(format!("{triangle:?} leaves the header's bounds {allowed:?}"));
    }
    Ok(())
}

/// The quanta of a coordinate, rounded down.
fn whole(coordinate: i64) -> i32 {
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

/// Some triangles in no order, and a surface of their bounds.
#[cfg(test)]
pub(in crate::buildfile) fn triangles(count: usize, seed: u64) -> (Surface, Vec<Triangle>) {
    let mut state = seed;
    let mut value = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 20) as i64 % (100_000 * QUANTUM_FRACTIONS) - 1000 * QUANTUM_FRACTIONS
    };
    let mut triangle = || Triangle::new([0; 3].map(|_| [0; 3].map(|_| value())));
    let triangles: Vec<_> = (0..count).map(|_| triangle()).collect();
    (Surface::of(&triangles), triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_columns_are_refused_or_lie_within_the_bounds() {
        let (surface, mut sorted) = triangles(300, 5);
        sorted.sort_by_key(Primitive::key);
        let mut whole = Unpacked::default();
        Triangle::encode(&sorted, &mut whole);
        let mut scratch = Scratch::default();
        let (mut refused, mut state) = (0, 1_u64);
        for _ in 0..4000 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let mut bytes = whole.bytes.clone();
            let at = (state >> 33) as usize % bytes.len();
            bytes[at] = (state >> 24) as u8;
            let mut found = Vec::new();
            if Triangle::decode(&bytes, 300, &surface, &mut scratch, &mut found).is_err() {
                refused += 1;
                continue;
            }
            let within = |triangle: &Triangle| {
                triangle.corners.iter().all(|corner| {
                    (0..3).all(|axis| {
                        let quanta = corner[axis] as f64 / QUANTUM_FRACTIONS as f64;
                        (f64::from(surface.bounds.min[axis])..=f64::from(surface.bounds.max[axis])).contains(&quanta)
                    })
                })
            };
            assert!(found.iter().all(within), "byte {at}");
        }
        assert!(refused > 500, "{refused} of 4000");
    }
}
