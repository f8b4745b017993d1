//! What is inside at a point: fields of convolution struts, exact unions, and the kernels that evaluate them row by row.
//!
//! Nothing here knows files, devices or threads. A [`Shape`] draws a [`Block`] of struts and balls on a [`Strip`], a few rows
//! of a picture in one [`Plane`]. Lengths are in the solid's own unit: the kernel's support R for a [`Convolution`] (so that
//! every quantity of the kernel is about 1 and `f32` suffices), micrometres for a [`Union`].
//!
//! ```
//! use layerd::solid::{self, Beam};
//! // A long strut prints at its radius: on its surface the field is the isovalue.
//! let beam = Beam { a: [0.0; 3], b: [0.0, 0.0, 100.0], radius_a: 1.0, radius_b: 1.0, caps: [solid::Cap::Sphere; 2] };
//! let field = solid::reference::beam_field(&beam, 1.5, [1.0, 0.0, 50.0]);
//! assert!((field - solid::ISOVALUE).abs() < 1e-12);
//! ```

mod block;
mod convolution;
mod instruction_set;
mod lowest;
mod pixels;
mod probe;
pub mod reference;
mod strip;
mod union;
mod vector;
mod weight;

pub use block::{Block, Record};
pub use convolution::Convolution;
pub use instruction_set::InstructionSet;
pub use lowest::lowest_z;
pub use probe::PlaneProbe;
pub use strip::{Effort, Grid, Plane, Strip};
pub use union::Union;
pub use weight::LARGEST_RADIUS_SHARE;

/// The isovalue C: solid where the field reaches it. Weights are proportional to C, so its value is free.
pub const ISOVALUE: f64 = 1.0;

/// Largest radius in quanta: leaves two bits for a cap, and room to add radii to coordinates.
pub const LARGEST_RADIUS: u32 = (1 << 30) - 1;

/// The shape of a strut's end under exact union.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cap {
    /// A whole ball of the end's radius.
    Sphere,
    /// The half of that ball beyond the end.
    Hemisphere,
    /// A flat end, square to the strut.
    Butt,
}

/// A strut between two points with linearly varying radius, or a ball where both points are one. Any unit of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// One end.
    pub a: [f64; 3],
    /// The other.
    pub b: [f64; 3],
    /// Radius at `a`.
    pub radius_a: f64,
    /// Radius at `b`.
    pub radius_b: f64,
    /// Ends at `a` and `b`; means nothing to a convolution surface.
    pub caps: [Cap; 2],
}

/// Unit vector from `a` to `b` and the length between them; where both are one, the zero vector and 0.
fn direction(a: [f64; 3], b: [f64; 3]) -> ([f64; 3], f64) {
    let edge = glam::DVec3::from(b) - glam::DVec3::from(a);
    let length = edge.length();
    if length > 0.0 { ((edge / length).to_array(), length) } else { ([0.0; 3], 0.0) }
}

/// A kind of solid: how struts and balls are drawn in a plane.
pub trait Shape: Send + Sync + Sized {
    /// What a strip holds for each pixel while struts are drawn.
    type Cell: Copy + Default + Send;

    /// Rows above and below a band, and columns beside it, that [`Shape::merge_coverage`] must know.
    const HALO: usize;

    /// What a [`Record`] keeps of radii, in quanta and at most [`LARGEST_RADIUS`], and caps. `quantum` is a quantum's length
    /// in the solid's unit.
    fn ends(radii: [u32; 2], caps: [Cap; 2], is_ball: bool, quantum: f64) -> [u32; 2];

    /// Draws the records of blocks, in their order, on the rows of `strip`.
    fn draw<'a>(
        instructions: InstructionSet,
        blocks: impl Iterator<Item = &'a Block>,
        plane: &Plane,
        strip: &mut Strip<Self::Cell>,
    );

    /// Sets the bits of one row's pixels that are solid at their centres, the first pixel of a byte in its highest bit, beginning
    /// with pixel `8 × first_byte`, and leaves all others as they are; `row` counts from the band's first.
    fn merge_bits(
        instructions: InstructionSet,
        strip: &Strip<Self::Cell>,
        row: usize,
        first_byte: usize,
        out: &mut [u8],
    );

    /// Raises one row's pixels from `first_pixel` on to their covered shares, 0 to 255, where they are less; `row` counts from
    /// the band's first.
    fn merge_coverage(
        instructions: InstructionSet,
        strip: &Strip<Self::Cell>,
        row: usize,
        first_pixel: usize,
        out: &mut [u8],
    );
}
