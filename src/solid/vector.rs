//! The field of struts on vectors of pixels. [`super::instruction_set`] lists the operations that are allowed here.
//!
//! All forms below follow from the closed form in [`super::reference`], with R = 1. `convolution` draws footprints with them.

/// Pixels evaluated, or struts cut, at once. Rows of a strut are often some 15 pixels wide, so most of a longer vector
/// would be wasted.
pub(super) const LANES: usize = 8;

/// The number of each lane.
pub(super) const LANE: [f32; LANES] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// `max` as one instruction. No operand is ever NaN.
#[inline(always)]
pub(super) fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// `min` as one instruction. No operand is ever NaN.
#[inline(always)]
pub(super) fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `a·b + c`.
#[inline(always)]
pub(super) fn multiply_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// One strut on a stretch of one row, in `f32`. `d` is the distance in pixels from a base pixel near the axis of the strut: then
/// `q = q_base − d (slope + curve·d)` does not lose digits to cancellation.
#[derive(Clone, Copy)]
pub(super) struct Stretch {
    /// `1 − h²` at the base pixel, h the distance from the strut's axis in units of R.
    pub(super) q_base: f32,
    /// First-order change of h² per pixel.
    pub(super) slope: f32,
    /// Second-order change of h² per pixel.
    pub(super) curve: f32,
    /// Start of the strut, measured from the foot of the base pixel: −t.
    pub(super) lo_base: f32,
    /// End of the strut, measured from the same point: L − t.
    pub(super) hi_base: f32,
    /// Change of t per pixel.
    pub(super) axial: f32,
    /// `weight[0] + weight[1]·t`, times R.
    pub(super) weight: [f32; 2],
    /// `d` of the first pixel.
    pub(super) first_d: f32,
}

/// A strut as seen from one pixel.
#[derive(Clone, Copy)]
pub(super) struct Point {
    /// `1 − h²`, with h the distance from the axis in units of R. If it is 0 or less, the strut is out of reach.
    pub(super) q: f32,
    /// Start of the strut, measured from the pixel's foot on the axis.
    pub(super) lo: f32,
    /// End of the strut, measured from the same point.
    pub(super) hi: f32,
}

/// The field of a strut, given which of its ends may be within reach. All pixels that are evaluated together use the same
/// implementation. Most pixels see one end or none, which takes fewer operations.
pub(super) trait Ends {
    /// `field` plus the field of the strut at a pixel. `weight` is the weight at the start of the strut, and its change per unit of length.
    fn plus<const FUSED: bool>(field: f32, point: Point, weight: [f32; 2]) -> f32;
}

/// No end is within reach: with lo = −√q and hi = √q the closed form becomes `16/15 q² √q`. Of a linear weight only the value at the
/// foot matters.
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

/// One end is within reach, and the weight is constant. Let x be the distance from the foot to that end. The side of the other end
/// contributes `8/15 q² √q`, and this side `G(x) = x (q² − x² (⅔ q − x²/5))`.
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

/// Both ends are within reach. With D = hi − lo, S = hi + lo, P = hi·lo and e = S² − P the closed form is
/// `G(hi) − G(lo) = D (q² − ⅔ q e + (e² − P S²)/5)`. It does not subtract nearly equal numbers if the strut is short.
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
    /// `1 − h²` at `d` pixels from the base pixel.
    #[inline(always)]
    fn q<const FUSED: bool>(&self, d: f32) -> f32 {
        multiply_add::<FUSED>(-d, multiply_add::<FUSED>(self.curve, d, self.slope), self.q_base)
    }
}

/// Adds the field of a strut to whole vectors of pixels.
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

/// Adds the field of a ball, `w q²`, to whole vectors of pixels.
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

/// Places and weights of the quadrature of Gauss and Legendre with four points in −1 to 1. It is exact for polynomials up to degree 7.
const GAUSS: [(f32, f32); 4] = [
    (-0.861_136_3, 0.347_854_85),
    (-0.339_981_04, 0.652_145_15),
    (0.339_981_04, 0.652_145_15),
    (0.861_136_3, 0.347_854_85),
];

/// Adds `bow ∫ t (t − L) (q − x²)² dx` to whole vectors of pixels, over the part of the strut within reach: what a strut has beyond a linear weight if
/// it is the product of two linear functions. The integrand has degree 6. Its antiderivative would subtract nearly equal numbers.
#[inline(always)]
pub(super) fn add_bow<const FUSED: bool>(row: &mut [f32], stretch: Stretch, bow: f32) {
    let Stretch { lo_base, hi_base, axial, mut first_d, .. } = stretch;
    for pixels in row.as_chunks_mut::<LANES>().0 {
        for (lane, field) in pixels.iter_mut().enumerate() {
            let d = first_d + LANE[lane];
            let q = greater(stretch.q::<FUSED>(d), 0.0);
            let s = q.sqrt();
            let lo = multiply_add::<FUSED>(-axial, d, lo_base);
            let hi = multiply_add::<FUSED>(-axial, d, hi_base);
            let (from, to) = (lesser(greater(lo, -s), s), lesser(greater(hi, -s), s));
            let (middle, half) = ((from + to) * 0.5, (to - from) * 0.5);
            let mut sum = 0.0;
            for (place, weight) in GAUSS {
                let x = middle + half * place;
                let rest = q - x * x;
                sum += weight * (x - lo) * (x - hi) * (rest * rest);
            }
            *field += bow * half * sum;
        }
        first_d += LANES as f32;
    }
}
