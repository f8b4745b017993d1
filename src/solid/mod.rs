//! Which points are solid: the fields of convolution struts, exact unions, what triangles and displaced triangles enclose, and the kernels that evaluate them row by
//! row.
//!
//! [`soap`] makes smooth meshes of nodes.
//!
//! This module does not know files, devices or threads. A `Shape` draws a `Block` of struts and balls on a `Strip`, which is a few
//! rows of pixels in one `Plane`. Lengths are in the unit of the solid: the support R of the kernel for a `Convolution` (all
//! quantities of the kernel are then about 1, and `f32` is precise enough), micrometres for a `Union`.
//!
//! ```
//! use layerd::solid::{self, Beam};
//! // A long strut prints at its radius: the field on its surface is the isovalue.
//! let beam = Beam { a: [0.0; 3], b: [0.0, 0.0, 100.0], radius_a: 1.0, radius_b: 1.0, caps: [solid::Cap::Sphere; 2] };
//! let field = solid::reference::beam_field(&beam, 1.5, [1.0, 0.0, 50.0]);
//! assert!((field - solid::ISOVALUE).abs() < 1e-12);
//! ```

mod block;
mod convolution;
mod excess;
mod instruction_set;
mod joint;
mod lowest;
mod mesh;
mod pixels;
mod probe;
pub mod reference;
mod relief;
pub mod soap;
mod strip;
mod union;
mod vector;
mod weight;

pub(crate) use block::{Block, StrutRecord, WHOLE_SHARE};
pub(crate) use convolution::Convolution;
pub(crate) use excess::UnionExcess;
pub use instruction_set::InstructionSet;
pub(crate) use joint::{
    FieldOfMaterial, Halftone, JoinedShape, JoinedStretch, Joining, MAX_MATERIALS, Rule, SharedUnion,
};
pub(crate) use lowest::lowest_z;
pub(crate) use mesh::{Crossings, Facet, FieldRows, Resolution, SectionPlane, Segment, set_bits};
pub(crate) use probe::{Cut as ProbeCut, PlaneProbe, ProbeRecord};
pub(crate) use relief::{Dicing, Extent, Lift, PatchCorner, PatchShape, Window};
pub use relief::{HeightMap, Tile};
pub use strip::Effort;
pub(crate) use strip::{Grid, Plane, Strip};
pub(crate) use union::Union;
pub(crate) use weight::MAX_RADIUS_SHARE;

/// The isovalue C (Liu et al. 2021, Eq. 6): a point is solid if the field is at least C. All weights are proportional to C, so any
/// value would do.
pub const ISOVALUE: f64 = 1.0;

/// Largest radius, quanta. It leaves two bits of 32 for a cap, and room for adding a radius to a coordinate.
pub(crate) const MAX_RADIUS: u32 = (1 << 30) - 1;

/// The shape of one end of a strut under exact union. A convolution surface rounds all ends, and does not use it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cap {
    /// A ball around the node, with the radius of the end.
    #[default]
    Sphere,
    /// The half of that ball that lies beyond the end.
    Hemisphere,
    /// A flat end, in the plane through the node perpendicular to the strut.
    Butt,
}

/// A strut between two points, whose radius varies linearly, or a ball if the points are equal. Any unit of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// One end.
    pub a: [f64; 3],
    /// The other end.
    pub b: [f64; 3],
    /// Radius at `a`.
    pub radius_a: f64,
    /// Radius at `b`.
    pub radius_b: f64,
    /// Caps at `a` and `b`. A convolution surface does not use them.
    pub caps: [Cap; 2],
}

/// Unit vector from `a` to `b` and their distance; the zero vector and 0 if they are equal.
fn direction(a: [f64; 3], b: [f64; 3]) -> ([f64; 3], f64) {
    let edge = glam::DVec3::from(b) - glam::DVec3::from(a);
    let length = edge.length();
    if length > 0.0 { ((edge / length).to_array(), length) } else { ([0.0; 3], 0.0) }
}

/// A kind of solid: it draws struts and balls in a plane.
pub(crate) trait Shape: Send + Sync + Sized {
    /// Content of a strip for each pixel while struts are drawn.
    type Cell: Copy + Default + Send;

    /// Radii, in quanta and at most [`MAX_RADIUS`], and caps, in the form that a [`StrutRecord`] holds. `quantum` is the length of a
    /// quantum in the unit of the solid.
    fn ends(radii: [u32; 2], caps: [Cap; 2], is_ball: bool, quantum: f64) -> [u32; 2];

    /// Draws the records of the blocks, in order, on the rows of `strip`.
    fn draw<'a>(
        instructions: InstructionSet,
        blocks: impl Iterator<Item = &'a Block>,
        plane: &Plane,
        strip: &mut Strip<Self::Cell>,
    );
}

/// A shape whose cells become pixels.
pub(crate) trait PixelShape: Shape {
    /// Rows above and below a band, and columns at both sides, that [`PixelShape::merge_coverage`] reads.
    const HALO: usize;

    /// Sets the bits of the pixels of one row whose centres are solid; other bits stay. The first pixel of a byte is its highest bit;
    /// `out` begins with pixel `8 × first_byte`. `row` is counted from the first row of the band.
    fn merge_bits(
        instructions: InstructionSet,
        strip: &Strip<Self::Cell>,
        row: usize,
        first_byte: usize,
        out: &mut [u8],
    );

    /// Raises the pixels of one row to their covered shares, 0 to 255; greater values stay. `out` begins with pixel `first_pixel`.
    /// `row` is counted from the first row of the band.
    fn merge_coverage(
        instructions: InstructionSet,
        strip: &Strip<Self::Cell>,
        row: usize,
        first_pixel: usize,
        out: &mut [u8],
    );
}

/// A shape whose cells become a field: by how far each pixel's centre lies within the solid. The excess is 0 or more where the centre
/// is solid, changes continuously across the border, and near it is about the distance from it in micrometres.
pub(crate) trait FieldShape: Shape {
    /// Micrometres of excess for each unit of a cell, in a body whose largest radius is `radius_um`. `unit_um` is the unit of length.
    fn excess_um(unit_um: f64, radius_um: f64) -> f32;

    /// The excess of pixels that no strut reaches: the least one that counts. `pitch_um` is the larger pixel pitch.
    fn outside_um(excess_um: f32, pitch_um: f64) -> f32;

    /// Raises the pixels of one row to their excess, micrometres; greater values stay. `out` begins with pixel `first_pixel`. `row` is
    /// counted from the first row of the band.
    fn merge_excess(strip: &Strip<Self::Cell>, row: usize, first_pixel: usize, excess_um: f32, out: &mut [f32]);
}
