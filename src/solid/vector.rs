//! The inner loops, written once and compiled for several instruction sets.
//!
//! Only `+ − × √`, comparisons and selects, lane by lane in a fixed order, no fused multiply-add: IEEE 754 makes every one of
//! them exact to the last bit, so every path gives equal bits.

/// Pixels evaluated at once. Rows of a strut are often some 15 pixels wide: longer vectors would mostly overshoot.
pub(super) const LANES: usize = 8;

/// The instruction set the kernels run on. All give equal bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Path(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    /// What the compiler may assume for the target: SSE2 on x86-64, NEON on aarch64.
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Vectors stay as long as AVX2's; more registers and masks are what is gained.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Path {
    /// The paths this processor can take, the best last.
    pub fn available() -> Vec<Self> {
        let mut paths = vec![Self(Set::Baseline)];
        #[cfg(target_arch = "x86_64")]
        {
            use std::is_x86_feature_detected as has;
            if has!("avx2") {
                paths.push(Self(Set::Avx2));
            }
            if has!("avx2") && has!("avx512f") && has!("avx512vl") && has!("avx512bw") && has!("avx512dq") {
                paths.push(Self(Set::Avx512));
            }
        }
        paths
    }

    /// The best path of this processor.
    pub fn detect() -> Self {
        Self::available().pop().unwrap_or(Self(Set::Baseline))
    }

    /// Runs `work` compiled for this path; `work` must be `#[inline(always)]` to profit.
    #[inline(always)]
    pub(super) fn run(self, work: impl Work) {
        match self.0 {
            Set::Baseline => work.run(),
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code, reason = "calls code compiled for AVX2; see the proof")]
            // SAFETY: `Set::Avx2` is private to this module and made only by `available`, after the processor said it has AVX2.
            Set::Avx2 => unsafe { run_avx2(work) },
            #[cfg(target_arch = "x86_64")]
            #[allow(unsafe_code, reason = "calls code compiled for AVX-512; see the proof")]
            // SAFETY: `Set::Avx512` is private to this module and made only by `available`, after the processor said it has all
            // the features that `run_avx512` enables.
            Set::Avx512 => unsafe { run_avx512(work) },
        }
    }
}

/// A body to be compiled for each path.
pub(super) trait Work {
    /// Does it.
    fn run(self);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2(work: impl Work) {
    work.run();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512vl,avx512bw,avx512dq")]
fn run_avx512(work: impl Work) {
    work.run();
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

/// A strut's field at a pixel; `weight` at the strut's start and its change a unit of length. With D = hi − lo, S = hi + lo,
/// P = hi·lo, e = S² − P the closed form is `G(hi) − G(lo) = D (q² − ⅔ q e + (e² − P S²)/5)`: no difference of nearly equal
/// numbers for short struts.
#[inline(always)]
pub(super) fn strut_field<const TAPERED: bool>(point: Point, weight: [f32; 2]) -> f32 {
    let q = greater(point.q, 0.0);
    let s = q.sqrt();
    let lo = lesser(greater(point.lo, -s), s);
    let hi = lesser(greater(point.hi, -s), s);
    let (difference, sum, product) = (hi - lo, hi + lo, hi * lo);
    let square = sum * sum;
    let e = square - product;
    let mean = q * q - q * e * (2.0 / 3.0) + (e * e - product * square) * 0.2;
    if TAPERED {
        let (first, last) = (q - lo * lo, q - hi * hi);
        let cubes = first * first + first * last + last * last;
        let local = weight[0] - weight[1] * point.lo;
        difference * (local * mean + weight[1] * sum * cubes * (1.0 / 6.0))
    } else {
        weight[0] * (difference * mean)
    }
}

/// Adds a strut's field to whole vectors of pixels.
#[inline(always)]
pub(super) fn add_strut<const TAPERED: bool>(row: &mut [f32], stretch: Stretch) {
    let Stretch { q_base, slope, curve, lo_base, hi_base, axial, weight, mut first_d } = stretch;
    for pixels in row.as_chunks_mut::<LANES>().0 {
        for (lane, field) in pixels.iter_mut().enumerate() {
            let d = first_d + LANE[lane];
            let moved = axial * d;
            let point = Point { q: q_base - d * (slope + curve * d), lo: lo_base - moved, hi: hi_base - moved };
            *field += strut_field::<TAPERED>(point, weight);
        }
        first_d += LANES as f32;
    }
}

/// Adds the field of a strut where its ends are out of reach: lo = −√q and hi = √q leave `16/15 q² √q`, and of a linear
/// weight only its value at the foot.
#[inline(always)]
pub(super) fn add_endless<const TAPERED: bool>(row: &mut [f32], stretch: Stretch) {
    let Stretch { q_base, slope, curve, lo_base, axial, weight, mut first_d, .. } = stretch;
    let weight = weight.map(|weight| weight * (16.0 / 15.0));
    for pixels in row.as_chunks_mut::<LANES>().0 {
        for (lane, field) in pixels.iter_mut().enumerate() {
            let d = first_d + LANE[lane];
            let q = greater(q_base - d * (slope + curve * d), 0.0);
            let local = if TAPERED { weight[0] + weight[1] * (axial * d - lo_base) } else { weight[0] };
            *field += local * (q * q * q.sqrt());
        }
        first_d += LANES as f32;
    }
}

/// Adds a ball's field, `w q²`.
#[inline(always)]
pub(super) fn add_ball(row: &mut [f32], stretch: Stretch) {
    let Stretch { q_base, slope, curve, weight, mut first_d, .. } = stretch;
    for pixels in row.as_chunks_mut::<LANES>().0 {
        for (lane, field) in pixels.iter_mut().enumerate() {
            let d = first_d + LANE[lane];
            let q = greater(q_base - d * (slope + curve * d), 0.0);
            *field += weight[0] * (q * q);
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
    fn run(self) {
        for (byte, cells) in self.out.iter_mut().zip(self.cells.as_chunks::<8>().0) {
            let mut bits = 0;
            for (lane, field) in cells.iter().enumerate() {
                bits |= if *field >= super::ISOVALUE as f32 { 0x80_u32 >> lane } else { 0 };
            }
            *byte = bits as u8;
        }
    }
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
    fn run(self) {
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
