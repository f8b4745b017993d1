//! Triangles as primitives. `tests/pack_mesh` writes and reads them; the unit tests of `sort` and `store/chunker.rs` use them, too.
//!
//! ```text
//! 0  u8 × 18 widths, one for each column
//! 18 columns of corners (`corners`)
//! ```

use super::columns::{Scratch, Unpacked};
use super::corners::{self, CORNER_COLUMNS, Corners, whole};
use super::{Key, Primitive, Sortable};
use crate::buildfile::model::{Surface, Triangle, corner_key};

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

impl Sortable for Triangle {
    type Key = TriangleKey;

    fn key(&self) -> TriangleKey {
        let words = self.corners.map(corner_key);
        TriangleKey(std::array::from_fn(|word| words[word / 3][word % 3] as u64 ^ 1 << 63))
    }

    fn of_key(TriangleKey(words): &TriangleKey) -> Self {
        let value = |word: usize| (words[word] ^ 1 << 63) as i64;
        // `corner_key` turns a corner around, and back.
        Self { corners: [0, 3, 6].map(|word| corner_key([value(word), value(word + 1), value(word + 2)])) }
    }
}

impl Primitive for Triangle {
    type Body = Surface;

    /// So many take 144 KiB: a chunk is decoded within a level-2 cache, and a print holds one for each thread.
    const CHUNK_PRIMITIVES: usize = 2048;

    const SCRATCH_BYTES: usize = 2 * size_of::<u32>();

    fn z_range(&self) -> [i32; 2] {
        let [a, b, c] = self.corners.map(|corner| corner[2]);
        [whole(a.min(b).min(c)), -whole(-a.max(b).max(c))]
    }

    fn encode(triangles: &[Self], out: &mut Unpacked) {
        out.bytes.resize(CORNER_COLUMNS, 0);
        corners::encode(triangles, out);
    }

    fn decode(
        bytes: &[u8],
        count: u32,
        surface: &Surface,
        scratch: &mut Scratch,
        out: &mut Vec<Self>,
    ) -> Result<(), String> {
        let (widths, bytes) = bytes.split_first_chunk::<CORNER_COLUMNS>().ok_or("it is shorter than a chunk's head")?;
        let first = out.len();
        out.resize(first + count as usize, Self { corners: [[0; 3]; 3] });
        let triangles = &mut out[first..];
        let (bytes, is_within) = corners::decode(bytes, widths, &mut scratch.columns, triangles, &surface.bounds)?;
        if !bytes.is_empty() {
            return Err(format!("{} bytes follow its columns", bytes.len()));
        }
        if is_within && triangles.iter().all(begins_lowest) {
            return Ok(());
        }
        triangles.iter().try_for_each(|triangle| check(triangle, surface))
    }
}

impl Corners for Triangle {
    fn corner(&self, number: usize) -> &[i64; 3] {
        &self.corners[number]
    }

    fn corner_mut(&mut self, number: usize) -> &mut [i64; 3] {
        &mut self.corners[number]
    }
}

/// Whether no corner is lower than the first.
fn begins_lowest(triangle: &Triangle) -> bool {
    let [a, b, c] = &triangle.corners;
    // The order within a height seldom matters.
    a[2] < b[2].min(c[2]) || [b, c].into_iter().all(|corner| corner_key(*a) <= corner_key(*corner))
}

/// # Errors
/// A text if the triangle does not begin with its lowest corner, or leaves the bounds of the surface.
fn check(triangle: &Triangle, surface: &Surface) -> Result<(), String> {
    triangle.check_range()?;
    if !begins_lowest(triangle) {
        return Err(format!("{triangle:?} does not begin with its lowest corner"));
    }
    let (found, allowed) = (triangle.bounds(), &surface.bounds);
    if (0..3).any(|axis| found.min[axis] < allowed.min[axis] || found.max[axis] > allowed.max[axis]) {
        return Err(format!("{triangle:?} leaves the header's bounds {allowed:?}"));
    }
    Ok(())
}

/// Some triangles in no order, and a surface of their bounds.
#[cfg(test)]
pub(in crate::buildfile) fn triangles(count: usize, seed: u64) -> (Surface, Vec<Triangle>) {
    use crate::buildfile::model::QUANTUM_FRACTIONS;

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
    use crate::buildfile::model::QUANTUM_FRACTIONS;

    #[test]
    fn a_chunk_of_any_length_comes_back() {
        // More than are written today: files that have them are read.
        for count in [1, 2048, 8192] {
            let (surface, mut sorted) = triangles(count, 9);
            sorted.sort_by_key(Sortable::key);
            let mut whole = Unpacked::default();
            Triangle::encode(&sorted, &mut whole);
            let mut found = Vec::new();
            let decoded = Triangle::decode(&whole.bytes, count as u32, &surface, &mut Scratch::default(), &mut found);
            assert_eq!((decoded, found == sorted), (Ok(()), true));
        }
    }

    #[test]
    fn each_statement_about_a_triangle_is_checked() {
        let (surface, sorted) = triangles(3, 4);
        let said = |triangles: &[Triangle], surface: &Surface| {
            let mut whole = Unpacked::default();
            Triangle::encode(triangles, &mut whole);
            Triangle::decode(&whole.bytes, 3, surface, &mut Scratch::default(), &mut Vec::new())
        };
        assert_eq!(said(&sorted, &surface), Ok(()));
        let mut turned = sorted.clone();
        turned[1].corners.rotate_left(1);
        assert!(said(&turned, &surface).is_err_and(|said| said.contains("does not begin with its lowest corner")));
        for axis in 0..3 {
            let mut narrow = [surface.clone(), surface.clone()];
            narrow[0].bounds.min[axis] += 1;
            narrow[1].bounds.max[axis] -= 1;
            for surface in narrow {
                assert!(said(&sorted, &surface).is_err_and(|said| said.contains("leaves the header's bounds")));
            }
        }
        let mut whole = Unpacked::default();
        Triangle::encode(&sorted, &mut whole);
        // The highest byte of the last fraction.
        *whole.bytes.last_mut().expect("it has columns") = 0x10;
        let decoded = Triangle::decode(&whole.bytes, 3, &surface, &mut Scratch::default(), &mut Vec::new());
        assert!(decoded.is_err_and(|said| said.contains("a fraction of a quantum is not below")));
    }

    #[test]
    fn damaged_columns_are_refused_or_lie_within_the_bounds() {
        let (surface, mut sorted) = triangles(300, 5);
        sorted.sort_by_key(Sortable::key);
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
