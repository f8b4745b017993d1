//! Triangles, the second kind of primitive: only tests use them, to show that sorting and chunks do not depend on struts.
//! The unit tests of `sort` and `store/chunker.rs` use them.

use super::columns::{self, Scratch, Unpacked};
use super::{Key, Primitive};

/// A triangle of a mesh, its lowest vertex first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::buildfile) struct Triangle([[i32; 3]; 3]);

/// z, y and x of each vertex, their sign bits inverted, so that unsigned order is signed order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::buildfile) struct TriangleKey([u32; 9]);

impl Key for TriangleKey {
    const BYTES: usize = 36;

    const END: Self = Self([u32::MAX; 9]);

    fn append_to(self, bytes: &mut Vec<u8>) {
        self.0.iter().for_each(|word| bytes.extend_from_slice(&word.to_le_bytes()));
    }

    fn from_bytes(bytes: &[u8]) -> Self {
        let mut words = [0; 9];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
            *word = u32::from_le_bytes(*bytes);
        }
        Self(words)
    }
}

impl Primitive for Triangle {
    type Key = TriangleKey;
    /// The lowest z allowed.
    type Body = i32;

    const SCRATCH_BYTES: usize = 36;

    fn key(&self) -> TriangleKey {
        let mut words = [0; 9];
        for (word, value) in words.iter_mut().zip(self.0.iter().flat_map(|vertex| vertex.iter().rev())) {
            *word = *value as u32 ^ 1 << 31;
        }
        TriangleKey(words)
    }

    fn of_key(TriangleKey(words): &TriangleKey) -> Self {
        let value = |at: usize| (words[at] ^ 1 << 31) as i32;
        Self([0, 1, 2].map(|vertex| [2, 1, 0].map(|axis| value(3 * vertex + axis))))
    }

    fn z_range(&self) -> [i32; 2] {
        let [a, b, c] = self.0;
        [a[2], b[2].max(c[2])]
    }

    /// Nine columns, in zigzag.
    fn encode(triangles: &[Self], out: &mut Unpacked) {
        for (vertex, axis) in places() {
            let width = out.bytes.len();
            out.bytes.push(0);
            out.bytes[width] = out.add(triangles.iter().map(|triangle| columns::zigzag(triangle.0[vertex][axis])));
        }
    }

    fn decode(
        mut bytes: &[u8],
        count: u32,
        lowest: &i32,
        scratch: &mut Scratch,
        out: &mut Vec<Self>,
    ) -> Result<(), String> {
        for column in &mut scratch.columns {
            let (width, rest) = bytes.split_first().ok_or("a column is missing")?;
            bytes = columns::take(rest, count as usize, *width, column).ok_or("a column is cut short")?;
        }
        for number in 0..count as usize {
            let mut triangle = Self([[0; 3]; 3]);
            for ((vertex, axis), column) in places().zip(&scratch.columns) {
                triangle.0[vertex][axis] = columns::unzigzag(column[number]);
            }
            out.push(triangle);
            if triangle.0[0][2] < *lowest {
                return Err(format!("{triangle:?} is too low"));
            }
        }
        Ok(())
    }
}

/// Vertex and axis of each column.
fn places() -> impl Iterator<Item = (usize, usize)> {
    (0..9).map(|column| (column / 3, column % 3))
}

/// Some triangles in no order, all above z = −1000.
pub(in crate::buildfile) fn triangles(count: usize, seed: u64) -> Vec<Triangle> {
    let mut state = seed;
    let mut value = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as i32 % 100_000 - 1000
    };
    let mut triangle = || {
        let mut vertices = [0; 3].map(|_| [0; 3].map(|_| value()));
        vertices.sort_by_key(|vertex| vertex[2]);
        Triangle(vertices)
    };
    (0..count).map(|_| triangle()).collect()
}
