//! From fields to pixels, a row at a time.

use super::instruction_set::Work;
use super::vector::{greater, lesser};

/// Sets the bits of pixels whose fields reach the isovalue, the first pixel of a byte in its highest bit.
pub(super) struct PackBits<'a> {
    /// At least eight for each byte.
    pub(super) cells: &'a [f32],
    /// Where to.
    pub(super) out: &'a mut [u8],
}

impl Work for PackBits<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        for (byte, cells) in self.out.iter_mut().zip(self.cells.as_chunks::<8>().0) {
            *byte |= packed(cells);
        }
    }
}

/// Eight pixels as a byte.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn packed(cells: &[f32; 8]) -> u8 {
    #[allow(unsafe_code, reason = "calls code compiled for SSE; see the proof")]
    // SAFETY: every x86-64 processor has SSE.
    unsafe {
        packed_sse(cells)
    }
}

/// With the instruction that collects signs, which compilers do not find by themselves: in half the time. Its lowest bit is
/// the first pixel's; reversed by a table, as compilers make eight loads of a reversed vector.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "sse")]
fn packed_sse(cells: &[f32; 8]) -> u8 {
    use std::arch::x86_64::{_mm_cmpge_ps, _mm_movemask_ps, _mm_set1_ps, _mm_setr_ps};
    let isovalue = _mm_set1_ps(super::ISOVALUE as f32);
    let [a, b, c, d, e, f, g, h] = *cells;
    let first = _mm_movemask_ps(_mm_cmpge_ps(_mm_setr_ps(a, b, c, d), isovalue));
    let last = _mm_movemask_ps(_mm_cmpge_ps(_mm_setr_ps(e, f, g, h), isovalue));
    REVERSED[usize::from((first | last << 4) as u8)]
}

/// Each byte with its bits in reversed order.
#[cfg(target_arch = "x86_64")]
const REVERSED: [u8; 256] = {
    let mut reversed = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        reversed[byte] = (byte as u8).reverse_bits();
        byte += 1;
    }
    reversed
};

/// Eight pixels as a byte.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
fn packed(cells: &[f32; 8]) -> u8 {
    let isovalue = super::ISOVALUE as f32;
    cells.iter().fold(0, |bits, field| bits << 1 | u8::from(*field >= isovalue))
}

/// Raises a row's pixels to their covered shares.
///
/// The half-plane that the field's mean over the pixel and its gradient (central differences, in pixels) describe, cut with
/// the pixel. The mean, to second order the value plus a 24th of the Laplacian, allows for what a half-plane cannot show:
/// that the border bends and that the field is steeper on one side. With the value at the centre instead, discs of three
/// pixels' radius come out 1 to 3 % too large.
pub(super) struct Coverage<'a> {
    /// Fields above, of and below the row, from the pixel left of the first on.
    pub(super) around: [&'a [f32]; 3],
    /// Where to, 0 to 255.
    pub(super) out: &'a mut [u8],
}

impl Work for Coverage<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let count = self.out.len();
        let [above, row, below] = self.around;
        let (left, here, right) = (&row[..count], &row[1..=count], &row[2..count + 2]);
        let (above, below) = (&above[1..=count], &below[1..=count]);
        for (pixel, grey) in self.out.iter_mut().enumerate() {
            let (left, right, above, below) = (left[pixel], right[pixel], above[pixel], below[pixel]);
            let laplacian = (left + right) + (above + below) - 4.0 * here[pixel];
            let excess = here[pixel] + laplacian * (1.0 / 24.0) - super::ISOVALUE as f32;
            let (gx, gy) = ((right - left).abs() * 0.5, (below - above).abs() * 0.5);
            let share = half_plane_coverage(excess, greater(gx, gy), lesser(gx, gy));
            *grey = (*grey).max((share * 255.0 + INTEGERS).to_bits() as u8);
        }
    }
}

/// From here on an `f32` holds integers only, the lowest bits of its own bits. A cast would not compile to vectors.
const INTEGERS: f32 = 8_388_608.0;

/// Share of a unit square where `value + major·x + minor·y ≥ 0`, x and y within ±½, `major ≥ minor ≥ 0`. Without branches:
/// what is divided by zero is not taken.
#[inline(always)]
fn half_plane_coverage(value: f32, major: f32, minor: f32) -> f32 {
    let away = value.abs();
    let corner = (major + minor) * 0.5 - away;
    let strip = 0.5 - away / major;
    let triangle = corner * corner / (2.0 * major * minor);
    let lesser_part = if away <= (major - minor) * 0.5 { strip } else { triangle };
    let lesser_part = if corner <= 0.0 { 0.0 } else { lesser_part };
    if value >= 0.0 { 1.0 - lesser_part } else { lesser_part }
}
