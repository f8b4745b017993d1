//! From fields to pixels, one row at a time. `convolution` uses it for bits and for grey.

use super::instruction_set::Work;
use super::vector::{greater, lesser};

/// Sets the bits of pixels whose fields are at least the isovalue. The first pixel of a byte is its highest bit.
pub(super) struct PackBits<'a> {
    /// At least eight for each byte.
    pub(super) cells: &'a [f32],
    /// The bits.
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

/// Which of eight pixels' fields are at least the isovalue, as a byte.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(super) fn packed(cells: &[f32; 8]) -> u8 {
    #[allow(unsafe_code, reason = "calls code compiled for SSE; see the proof")]
    // SAFETY: every x86-64 processor has SSE.
    unsafe {
        packed_sse(cells)
    }
}

/// Uses the instruction that collects sign bits, which compilers do not choose by themselves; it halves the time. Its lowest bit is the
/// first pixel, so a table reverses the bits: compilers turn a reversed vector into eight loads.
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

/// Which of eight numbers are negative, as a byte; the first is the highest bit.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(super) fn sign_bits(numbers: &[f32; 8]) -> u8 {
    #[allow(unsafe_code, reason = "calls code compiled for SSE; see the proof")]
    // SAFETY: every x86-64 processor has SSE.
    unsafe {
        sign_bits_sse(numbers)
    }
}

#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "sse")]
fn sign_bits_sse(numbers: &[f32; 8]) -> u8 {
    use std::arch::x86_64::{_mm_movemask_ps, _mm_setr_ps};
    let [a, b, c, d, e, f, g, h] = *numbers;
    let (first, last) = (_mm_movemask_ps(_mm_setr_ps(a, b, c, d)), _mm_movemask_ps(_mm_setr_ps(e, f, g, h)));
    REVERSED[usize::from((first | last << 4) as u8)]
}

/// Which of eight numbers are negative, as a byte; the first is the highest bit.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
pub(super) fn sign_bits(numbers: &[f32; 8]) -> u8 {
    numbers.iter().fold(0, |bits, number| bits << 1 | u8::from(number.is_sign_negative()))
}

/// Every byte with its bits in reverse order.
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

/// Which of eight pixels' fields are at least the isovalue, as a byte.
#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
pub(super) fn packed(cells: &[f32; 8]) -> u8 {
    let isovalue = super::ISOVALUE as f32;
    cells.iter().fold(0, |bits, field| bits << 1 | u8::from(*field >= isovalue))
}

/// Raises the pixels of a row to their covered shares.
///
/// The field within a pixel is approximated by a linear function, whose gradient comes from central differences and whose value at the
/// centre is the mean of the field over the pixel. The covered share is the part of the pixel in the half-plane where that function is at
/// least the isovalue. To second order the mean is the centre's value plus Δ/24, where Δ is the Laplacian (the five-point difference):
/// it accounts for a curved border and for a field that is steeper on one side. With the centre's value itself, discs with a radius of
/// three pixels come out 1 to 3 % too large. Derivation: the Taylor series of the field to second order, integrated over the pixel.
pub(super) struct Coverage<'a> {
    /// Fields of the row above, the row itself and the row below, from the pixel left of the first one on.
    pub(super) around: [&'a [f32]; 3],
    /// The pixels, 0 to 255.
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
            *grey = (*grey).max((share * 255.0 + LOW_BITS_SHIFT).to_bits() as u8);
        }
    }
}

/// 2²³: added, it moves a whole number to the lowest bits, as an `f32` holds only integers from there on. A
/// cast would not compile to vector instructions.
const LOW_BITS_SHIFT: f32 = 8_388_608.0;

/// Share of a unit square in which `value + major·x + minor·y ≥ 0`, with x and y within ±½ and `major ≥ minor ≥ 0`. The smaller part
/// of a square cut by a line is a triangle or a trapezium, whose area is elementary. Without branches: results of a division by zero
/// are not used.
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
