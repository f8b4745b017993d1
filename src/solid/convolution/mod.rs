//! The convolution surface (closed form after Liu et al. 2021, §3). Unit of length: the support R, so that every quantity of
//! the kernel is about 1 and `f32` suffices.
//!
//! Eight struts of a block are cut with the plane at once ([`cut`]); most leave a footprint a few R wide, whose rows are found
//! eight at a time and drawn from one base pixel ([`footprint`]), or, where it is small, all alike ([`patch`]). Balls, very long
//! struts and those along the rows go row by row in `f64` ([`line`]).

mod cut;
mod footprint;
mod line;
mod patch;
mod reach;

use super::instruction_set::Work;
use super::pixels::{Coverage, PackBits};
use super::{Block, Cap, InstructionSet, Plane, Shape, Strip, weight};
use cut::Footprints;
use line::ConvolutionStrut;
use reach::{Reach, Window};

/// Solid where the summed field of all struts reaches the isovalue.
#[derive(Clone, Copy, Debug)]
pub struct Convolution;

/// Rows and columns are reached this much (in q, and in t) beyond the support. The `f32` field there is exactly 0, so which
/// of these pixels a vector happens to cover makes no difference.
const MARGIN: f64 = 1e-4;

/// Stands for 1/0: large beyond every picture, far from overflow.
const ENDLESS: f64 = 1e30;

impl Shape for Convolution {
    type Cell = f32;

    const HALO: usize = 1;

    /// The weights at both ends, as bits of `f32`; a ball has its own weight twice.
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
            for first in (0..count).step_by(cut::LANES) {
                let Some(chosen) = chosen[first..].first_chunk::<{ cut::LANES }>() else { return };
                let footprints = Footprints::new(block, chosen, &reach, plane, &window);
                for (lane, at) in chosen[..cut::LANES.min(count - first)].iter().enumerate() {
                    let at = usize::from(*at) % Block::LEN;
                    if reach.compact[at] == 0.0 {
                        ConvolutionStrut::new(block.get(at), plane).draw::<FUSED>(plane, strip);
                    } else {
                        footprint::draw::<FUSED>(&footprints, lane, strip);
                    }
                }
            }
        }
    }
}

/// From here on an `f64` holds integers only.
const INTEGERS: f64 = 4_503_599_627_370_496.0;

/// A number of cells rounded down, for less than half of [`INTEGERS`] to both sides; a cast would not compile to vectors.
#[inline(always)]
fn whole(x: f64) -> f64 {
    let rounded = (x + 1.5 * INTEGERS) - 1.5 * INTEGERS;
    rounded - if rounded > x { 1.0 } else { 0.0 }
}

fn reciprocal(x: f64) -> f64 {
    if x == 0.0 { ENDLESS } else { 1.0 / x }
}

/// `max` as one instruction; no operand is ever NaN.
#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// `min` as one instruction; no operand is ever NaN.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}
