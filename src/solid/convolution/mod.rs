//! The convolution surface (Liu et al. 2021, Eq. 6; closed form in [`reference`](super::reference)). Unit of length: the support R, so
//! that all quantities of the kernel are about 1 and `f32` is precise enough.
//!
//! [`reach`] selects the struts of a block that may reach the band. [`cut`] cuts eight of them with the plane at once. The footprint of
//! most struts is a few R wide: [`footprint`] finds its rows eight at a time and draws them from one base pixel, or, if it is small,
//! [`patch`] draws all rows alike. [`line`] draws balls, very long struts and struts along the rows, row by row in `f64`.
//!
//! `slice/body/lattice` draws with it; `tests/exact/` compares every pixel with the formulas.

mod cut;
mod footprint;
mod line;
mod patch;
mod reach;

use super::instruction_set::Work;
use super::pixels::{Coverage, PackBits};
use super::vector::{self, LANES};
use super::{Block, Cap, FieldShape, ISOVALUE, InstructionSet, PixelShape, Plane, Shape, Strip, weight};
use cut::Footprints;
use line::ConvolutionStrut;
use reach::{Reach, Window};

/// A point is solid if the summed field of all struts is at least the isovalue.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Convolution;

/// Margin added to the support, in q and in t, when rows and columns are selected. The `f32` field is exactly 0 within it, so it does
/// not matter which of these pixels a vector covers.
const MARGIN: f64 = 1e-4;

/// Replaces 1/0: larger than every picture, and far from overflow.
const ENDLESS: f64 = 1e30;

impl Shape for Convolution {
    type Cell = f32;

    /// The weights at both ends, as bits of `f32`. A ball has one weight, stored twice.
    fn ends(radii: [u32; 2], _caps: [Cap; 2], is_ball: bool, quantum: f64) -> [u32; 2] {
        let weight = if is_ball { weight::ball } else { weight::strut };
        radii.map(|radius| (weight(f64::from(radius) * quantum) as f32).to_bits())
    }

    fn draw<'a>(
        instructions: InstructionSet,
        blocks: impl Iterator<Item = &'a Block>,
        plane: &Plane,
        strip: &mut Strip<f32>,
    ) {
        instructions.run(Draw { blocks, plane, strip });
    }
}

impl PixelShape for Convolution {
    const HALO: usize = 1;

    fn merge_bits(instructions: InstructionSet, strip: &Strip<f32>, row: usize, first_byte: usize, out: &mut [u8]) {
        instructions.run(PackBits { cells: strip.pixels(row, first_byte * 8), out });
    }

    fn merge_coverage(
        instructions: InstructionSet,
        strip: &Strip<f32>,
        row: usize,
        first_pixel: usize,
        out: &mut [u8],
    ) {
        instructions.run(Coverage { around: strip.around(row, first_pixel), out });
    }
}

impl FieldShape for Convolution {
    /// The slope of the field on the surface of an endless strut of radius ρ: `F = C ((R² − h²) / (R² − ρ²))^{5/2}` at distance h, so
    /// `dF/dh = −5 C ρ / (R² − ρ²)` at ρ.
    fn excess_um(unit_um: f64, radius_um: f64) -> f32 {
        ((unit_um * unit_um - radius_um * radius_um) / (5.0 * ISOVALUE * radius_um)) as f32
    }

    fn outside_um(excess_um: f32, _pitch_um: f64) -> f32 {
        -(ISOVALUE as f32) * excess_um
    }

    fn merge_excess(strip: &Strip<f32>, row: usize, first_pixel: usize, excess_um: f32, out: &mut [f32]) {
        for (excess, field) in out.iter_mut().zip(strip.pixels(row, first_pixel)) {
            // The difference of two numbers near each other is exact, so its sign says what `merge_bits` says.
            *excess = vector::greater(*excess, (field - ISOVALUE as f32) * excess_um);
        }
    }
}

struct Draw<'a, Blocks> {
    blocks: Blocks,
    plane: &'a Plane,
    strip: &'a mut Strip<f32>,
}

impl<'a, Blocks: Iterator<Item = &'a Block>> Work for Draw<'_, Blocks> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self { blocks, plane, strip } = self;
        let window = Window::of(strip);
        let (mut reach, mut chosen) = (Reach::empty(), [0; reach::CHOSEN]);
        for block in blocks {
            let count = reach.look(block, plane, &window, &mut chosen);
            strip.count(block.len(), count);
            for first in (0..count).step_by(LANES) {
                let Some(chosen) = chosen[first..].first_chunk::<{ LANES }>() else { return };
                let mut footprints = Footprints::new(block, chosen, &reach, plane, &window);
                if let Some(shares) = &block.shares {
                    footprints.share(shares, chosen);
                }
                for (lane, at) in chosen[..LANES.min(count - first)].iter().enumerate() {
                    let at = usize::from(*at) % Block::LEN;
                    if reach.compact[at] == 0.0 || footprints.bow[lane] != 0.0 {
                        ConvolutionStrut::new(block.get(at), plane).draw::<FUSED>(plane, strip);
                    } else {
                        footprint::draw::<FUSED>(&footprints, lane, strip);
                    }
                }
            }
        }
    }
}

/// 1.5 · 2⁵²: added and taken away again, it rounds, as an `f64` holds only integers there.
const WHOLE_SHIFT: f64 = 6_755_399_441_055_744.0;

/// Rounds a number of cells down, within ±2⁵¹. A cast would not compile to vector instructions.
#[inline(always)]
fn whole(x: f64) -> f64 {
    let rounded = (x + WHOLE_SHIFT) - WHOLE_SHIFT;
    rounded - if rounded > x { 1.0 } else { 0.0 }
}

fn reciprocal(x: f64) -> f64 {
    if x == 0.0 { ENDLESS } else { 1.0 / x }
}

/// `max` as one instruction. No operand is ever NaN.
#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// `min` as one instruction. No operand is ever NaN.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}
