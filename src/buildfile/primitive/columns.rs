//! Columns of unsigned numbers as byte planes: the lowest byte of every value, then the second byte of every value, and so on.
//!
//! All values of a column have the same width, 0 to 4 bytes: fixed widths decode without branches. The compressor treats each plane
//! separately, because the bytes of a plane are distributed alike. `strut/chunk.rs` lays out struts with it.

/// Columns that one kind of primitive decodes at once: struts five, triangles and patches two.
const MAX_COLUMNS: usize = 5;

/// Buffers of [`Primitive::decode`](super::Primitive::decode), kept from chunk to chunk.
#[derive(Debug, Default)]
pub(in crate::buildfile) struct Scratch {
    pub(super) nodes: Vec<[i32; 3]>,
    pub(super) columns: [Vec<u32>; MAX_COLUMNS],
}

/// A chunk before compression.
#[derive(Debug, Default)]
pub(in crate::buildfile) struct Unpacked {
    /// Head and columns.
    pub(in crate::buildfile) bytes: Vec<u8>,
    /// Where each byte plane begins, ascending. Planes differ so much that each is worth its own table of symbols.
    pub(in crate::buildfile) planes: Vec<usize>,
    column: Vec<u32>,
}

impl Unpacked {
    /// Empties it for the next chunk.
    pub(in crate::buildfile) fn clear(&mut self) {
        self.bytes.clear();
        self.planes.clear();
    }

    /// Appends a column and returns its width.
    pub(super) fn add(&mut self, values: impl Iterator<Item = u32>) -> u8 {
        self.column.clear();
        self.column.extend(values);
        let width = width_bytes(&self.column);
        self.push(width);
        width
    }

    /// Appends a column of the given width, which all values fit.
    pub(super) fn add_wide(&mut self, values: impl Iterator<Item = u32>, width: u8) {
        self.column.clear();
        self.column.extend(values);
        self.push(width);
    }

    fn push(&mut self, width: u8) {
        let first = self.bytes.len();
        push(&self.column, width, &mut self.bytes);
        self.planes.extend((0..usize::from(width)).map(|plane| first + plane * self.column.len()));
    }
}

/// Bytes needed for the largest of `values`: 0 where all are zero.
fn width_bytes(values: &[u32]) -> u8 {
    let largest = values.iter().copied().max().unwrap_or(0);
    (u32::BITS - largest.leading_zeros()).div_ceil(8) as u8
}

/// A signed number as an unsigned one that is small where it is near 0: 0, −1, 1, −2, … become 0, 1, 2, 3, …
pub(super) fn zigzag(value: i32) -> u32 {
    (value << 1 ^ value >> 31) as u32
}

/// The number that [`zigzag`] made `value` of.
pub(super) fn unzigzag(value: u32) -> i32 {
    (value >> 1) as i32 ^ -((value & 1) as i32)
}

/// Appends `values` as `width` byte planes; every value must fit.
fn push(values: &[u32], width: u8, out: &mut Vec<u8>) {
    for plane in 0..u32::from(width) {
        out.extend(values.iter().map(|value| (value >> (8 * plane)) as u8));
    }
}

/// Reads `count` values of `width` bytes from the front of `bytes` into `out` and returns what follows them;
/// `None` where the bytes do not suffice or the width is not 0 to 4.
pub(super) fn take<'a>(bytes: &'a [u8], count: usize, width: u8, out: &mut Vec<u32>) -> Option<&'a [u8]> {
    let (column, rest) = bytes.split_at_checked(count * usize::from(width))?;
    out.clear();
    out.reserve_exact(count);
    if count == 0 {
        return (width <= 4).then_some(rest);
    }
    let mut planes = column.chunks_exact(count);
    let mut plane = || planes.next().unwrap_or(&[]).iter().map(|&byte| u32::from(byte));
    match width {
        0 => out.resize(count, 0),
        1 => out.extend(plane()),
        2 => out.extend(plane().zip(plane()).map(|(a, b)| a | b << 8)),
        3 => out.extend(plane().zip(plane()).zip(plane()).map(|((a, b), c)| a | b << 8 | c << 16)),
        4 => {
            let low = plane().zip(plane());
            let high = plane().zip(plane());
            out.extend(low.zip(high).map(|((a, b), (c, d))| a | b << 8 | c << 16 | d << 24));
        }
        _ => return None,
    }
    Some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signed_numbers_come_back() {
        for (value, zigzagged) in [(0, 0), (-1, 1), (1, 2), (-2, 3), (i32::MAX, u32::MAX - 1), (i32::MIN, u32::MAX)] {
            assert_eq!((zigzag(value), unzigzag(zigzagged)), (zigzagged, value));
        }
    }

    #[test]
    fn every_width_comes_back() {
        for largest in [0, 1, 255, 256, 65_535, 65_536, 1 << 24, u32::MAX] {
            let values = [0, largest / 3, largest, largest / 2];
            let width = width_bytes(&values);
            let mut bytes = Vec::new();
            push(&values, width, &mut bytes);
            bytes.push(7);
            let mut back = Vec::new();
            assert_eq!(take(&bytes, 4, width, &mut back), Some(&[7u8][..]));
            assert_eq!(back, values);
            assert!(take(&bytes, 100, width.max(1), &mut back).is_none(), "too short");
        }
        assert!(take(&[0; 64], 4, 5, &mut Vec::new()).is_none(), "no such width");
    }
}
