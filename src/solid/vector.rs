//! The inner loops, written once and compiled for several instruction sets.
//!
//! Only `+ − × √`, fused multiply-add, comparisons and selects, lane by lane in a fixed order: IEEE 754 makes every one of
//! them exact to the last bit, so every path of a processor gives equal bits. Whether products are fused with sums is the same
//! for all of them: where the processor can, always, else never; emulated, it would cost more than all the rest.

/// Pixels evaluated at once. Rows of a strut are often some 15 pixels wide: longer vectors would mostly overshoot.
pub(super) const LANES: usize = 8;

/// The instruction set the kernels run on. All that a processor can choose from give equal bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Path(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    /// What the compiler may assume for the target: SSE2 on x86-64, NEON on aarch64.
    Baseline,
    /// With FMA.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Vectors stay as long as AVX2's; more registers and masks are what is gained.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Path {
    /// The one compiled for the least processor of this architecture.
    pub const PORTABLE: Self = Self(Set::Baseline);

    /// The paths this processor may choose from, the best last.
    pub fn available() -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        {
            use std::is_x86_feature_detected as has;
            if has!("avx2") && has!("fma") {
                let mut paths = vec![Self(Set::Avx2)];
                if has!("avx512f") && has!("avx512vl") && has!("avx512bw") && has!("avx512dq") {
                    paths.push(Self(Set::Avx512));
                }
                return paths;
            }
        }
        vec![Self::PORTABLE]
    }

    /// The best path of this processor.
    pub fn detect() -> Self {
        Self::available().pop().unwrap_or(Self::PORTABLE)
    }

    /// Runs `work` compiled for this path; `work` must be `#[inline(always)]` to profit.
    #[inline(always)]
    pub(super) fn run(self, work: impl Work) {
        match self.0 {
            Set::Baseline => work.run::<BASELINE_FUSES>(),
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code, reason = "calls code compiled for AVX2; see the proof")]
            // SAFETY: `Set::Avx2` is private to this module and made only by `available`, after the processor said it has AVX2 and FMA.
            Set::Avx2 => unsafe { run_avx2(work) },
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code, reason = "calls code compiled for AVX-512; see the proof")]
            // SAFETY: `Set::Avx512` is private to this module and made only by `available`, after the processor said it has all
            // the features that `run_avx512` enables.
            Set::Avx512 => unsafe { run_avx512(work) },
        }
    }
}

/// Whether the baseline has an instruction that fuses.
const BASELINE_FUSES: bool = cfg!(target_arch = "aarch64");

/// A body to be compiled for each path.
pub(super) trait Work {
    /// Does it; where `FUSED`, with [`multiply_add`] in one instruction.
    fn run<const FUSED: bool>(self);
}

/// `a·b + c`.
#[inline(always)]
pub(super) fn multiply_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn run_avx2(work: impl Work) {
    work.run::<true>();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,avx512f,avx512vl,avx512bw,avx512dq")]
fn run_avx512(work: impl Work) {
    work.run::<true>();
}

/// A stretch of one row, of one strut, in `f32`. `d` counts pixels from a base pixel near the strut's axis, so that
/// `q = q_base − d (slope + curve·d)` loses nothing to cancellation.
#[derive(Clone, Copy)]
pub(super) struct Stretch {
    /// `1 − h²` at the base pixel, h the distance from the strut's axis in units of R.
    pub(super) q_base: f32,
    /// First-order change of h² a pixel.
    pub(super) slope: f32,
    /// Second-order change of h² a pixel.
    pub(super) curve: f32,
    /// Start of the strut measured from the foot of the base pixel: −t.
    pub(super) lo_base: f32,
    /// End of the strut measured from there: L − t.
    pub(super) hi_base: f32,
    /// Change of t a pixel.
    pub(super) axial: f32,
    /// `weight[0] + weight[1]·t`, times R.
    pub(super) weight: [f32; 2],
    /// Base pixel's offset: d of the first pixel.
    pub(super) first_d: f32,
}

/// What a pixel sees of a strut.
#[derive(Clone, Copy)]
pub(super) struct Point {
    /// `1 − h²`, h the distance from the strut's axis in units of R; 0 or less where nothing is within reach.
    pub(super) q: f32,
    /// Start of the strut measured from the pixel's foot on its axis.
    pub(super) lo: f32,
    /// End of the strut measured from there.
    pub(super) hi: f32,
}

/// A strut's field where certain of its ends may be within reach. Of one kind for all pixels that are evaluated together:
/// most of them see one end or none, and take half the operations.
pub(super) trait Ends {
    /// `field` and the strut's at a pixel; `weight` at the strut's start and its change a unit of length.
    fn plus<const FUSED: bool>(field: f32, point: Point, weight: [f32; 2]) -> f32;
}

/// Neither: lo = −√q and hi = √q leave `16/15 q² √q`, and of a linear weight only its value at the foot.
pub(super) struct NoEnd<const TAPERED: bool>;

impl<const TAPERED: bool> Ends for NoEnd<TAPERED> {
    #[inline(always)]
    fn plus<const FUSED: bool>(field: f32, point: Point, weight: [f32; 2]) -> f32 {
        let q = greater(point.q, 0.0);
        let weight = weight.map(|weight| weight * (16.0 / 15.0));
        let local = if TAPERED { weight[0] - weight[1] * point.lo } else { weight[0] };
        multiply_add::<FUSED>(local * (q * q), q.sqrt(), field)
    }
}

/// One of them, of a strut of one weight. With x from the foot to it, the other end leaves `8/15 q² √q` beside `G(x)`, where
/// `G(x) = x (q² − x² (⅔ q − x²/5))`.
pub(super) struct OneEnd<const UPPER: bool>;

impl<const UPPER: bool> Ends for OneEnd<UPPER> {
    #[inline(always)]
    fn plus<const FUSED: bool>(field: f32, point: Point, weight: [f32; 2]) -> f32 {
        let q = greater(point.q, 0.0);
        let s = q.sqrt();
        let x = lesser(greater(if UPPER { point.hi } else { -point.lo }, -s), s);
        let (q2, x2) = (q * q, x * x);
        let inner = multiply_add::<FUSED>(x2, 0.2, q * (-2.0 / 3.0));
        let this = x * multiply_add::<FUSED>(x2, inner, q2);
        multiply_add::<FUSED>(weight[0], multiply_add::<FUSED>(q2 * s, 8.0 / 15.0, this), field)
    }
}

/// Both. With D = hi − lo, S = hi + lo, P = hi·lo, e = S² − P the closed form is
/// `G(hi) − G(lo) = D (q² − ⅔ q e + (e² − P S²)/5)`: no difference of nearly equal numbers for short struts.
pub(super) struct BothEnds<const TAPERED: bool>;

impl<const TAPERED: bool> Ends for BothEnds<TAPERED> {
    #[inline(always)]
    fn plus<const FUSED: bool>(field: f32, point: Point, weight: [f32; 2]) -> f32 {
        let q = greater(point.q, 0.0);
        let s = q.sqrt();
        let lo = lesser(greater(point.lo, -s), s);
        let hi = lesser(greater(point.hi, -s), s);
        let (difference, sum, product) = (hi - lo, hi + lo, hi * lo);
        let square = sum * sum;
        let e = square - product;
        let quartic = multiply_add::<FUSED>(-product, square, e * e);
        let mean = multiply_add::<FUSED>(quartic, 0.2, q * multiply_add::<FUSED>(e, -2.0 / 3.0, q));
        if TAPERED {
            let (first, last) = (q - lo * lo, q - hi * hi);
            let cubes = first * first + first * last + last * last;
            let local = weight[0] - weight[1] * point.lo;
            field + difference * (local * mean + weight[1] * sum * cubes * (1.0 / 6.0))
        } else {
            multiply_add::<FUSED>(weight[0] * difference, mean, field)
        }
    }
}

impl Stretch {
    /// `1 − h²`, `d` pixels from the base.
    #[inline(always)]
    fn q<const FUSED: bool>(&self, d: f32) -> f32 {
        multiply_add::<FUSED>(-d, multiply_add::<FUSED>(self.curve, d, self.slope), self.q_base)
    }
}

/// Adds a strut's field to whole vectors of pixels.
#[inline(always)]
pub(super) fn add_strut<const FUSED: bool, E: Ends>(row: &mut [f32], stretch: Stretch) {
    let Stretch { lo_base, hi_base, axial, weight, mut first_d, .. } = stretch;
    for pixels in row.as_chunks_mut::<LANES>().0 {
        for (lane, field) in pixels.iter_mut().enumerate() {
            let d = first_d + LANE[lane];
            let lo = multiply_add::<FUSED>(-axial, d, lo_base);
            let hi = multiply_add::<FUSED>(-axial, d, hi_base);
            *field = E::plus::<FUSED>(*field, Point { q: stretch.q::<FUSED>(d), lo, hi }, weight);
        }
        first_d += LANES as f32;
    }
}

/// Adds a ball's field, `w q²`.
#[inline(always)]
pub(super) fn add_ball<const FUSED: bool>(row: &mut [f32], stretch: Stretch) {
    let Stretch { weight, mut first_d, .. } = stretch;
    for pixels in row.as_chunks_mut::<LANES>().0 {
        for (lane, field) in pixels.iter_mut().enumerate() {
            let q = greater(stretch.q::<FUSED>(first_d + LANE[lane]), 0.0);
            *field = multiply_add::<FUSED>(weight[0] * q, q, *field);
        }
        first_d += LANES as f32;
    }
}

/// Packs whether fields reach the isovalue, the first pixel of a byte in its highest bit.
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
            *byte = packed(cells);
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

/// Covered shares of a row's pixels.
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
            *grey = (share * 255.0 + INTEGERS).to_bits() as u8;
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

/// Numbers of the lanes.
pub(super) const LANE: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// `max` as one instruction; no operand is ever NaN.
#[inline(always)]
pub(super) fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// `min` as one instruction; no operand is ever NaN.
#[inline(always)]
pub(super) fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
