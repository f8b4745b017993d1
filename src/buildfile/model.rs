//! The contents of a build file, in the quantised units of the file.
//!
//! Coordinates are integers in units of [`Header::quantum_um`]. Comparing, sorting and sharing of nodes are therefore exact, and a file
//! means the same on every machine. [`buildfile`](crate::buildfile) has an example.

use std::ops::Range;

use bincode::{Decode, Encode};

use super::materials::{Materials, Shares};
use super::relief::{MapHeader, Relief};
pub use crate::solid::Cap;
use crate::solid::{Beam, Joining, Shape, StrutRecord};

/// Allowed lengths of a quantum, micrometres: from finer than any printer to as coarse as any part allows. With the finest, 2³⁰ quanta
/// are still 1 m.
pub(super) const QUANTA_UM: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

/// Default of the support R as a multiple of the largest radius (Liu et al. 2021, §3.2): every radius is then at most 2R/3.
pub(super) const SUPPORT_FACTOR: f64 = 1.5;

/// How overlapping struts become one solid.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub enum Joint {
    /// Convolution surface (Liu et al. 2021, Eq. 6): a point is solid if the summed field is at least
    /// [`ISOVALUE`](crate::solid::ISOVALUE).
    Convolution {
        /// Support R of the kernel, micrometres, the same for the whole body. Every radius is below 0.95 R.
        support_um: f64,
    },
    /// Exact union of beams and balls, as the 3MF beam lattice extension defines it.
    Union,
    /// The struts of each material as a convolution surface; where materials meet, elliptic arcs join their fields (heterogeneous lattices,
    /// Eq. 3.5, in the form for any number of materials that [`elliptic`](crate::solid::reference::elliptic) has).
    Elliptic {
        /// As that of a convolution.
        support_um: f64,
        /// The least field of the first and the second material, as a share of the other's, with which they take part in a blend: cot θ₂ and
        /// tan θ₁, above 0 and below 1. They are equal if there are more than two materials.
        least: [f64; 2],
    },
}

impl Joint {
    /// Support R of the kernel, micrometres; `None` of a union, which has none.
    pub fn support_um(&self) -> Option<f64> {
        match self {
            Self::Convolution { support_um } | Self::Elliptic { support_um, .. } => Some(*support_um),
            Self::Union => None,
        }
    }

    /// How the fields of several materials become one.
    pub(crate) fn joining(&self) -> Joining {
        match self {
            Self::Elliptic { least, .. } => Joining::elliptic(*least),
            Self::Convolution { .. } | Self::Union => Joining::Sum,
        }
    }
}

/// The caps of a strut at `a` and `b`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Caps {
    /// The cap at node `a`.
    pub a: Cap,
    /// The cap at node `b`.
    pub b: Cap,
}

/// A strut between two nodes, whose radius varies linearly from `a` to `b`, or a ball.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strut {
    /// Node a, quanta: the lower end, compared by z, then y, then x.
    pub a: [i32; 3],
    /// Node b, quanta. It equals `a` only in a ball.
    pub b: [i32; 3],
    /// Radius at `a`, quanta, at least 1.
    pub radius_a: u32,
    /// Radius at `b`, quanta, at least 1.
    pub radius_b: u32,
    /// End shapes.
    pub caps: Caps,
    /// How much of it is of the body's material; of a ball the same at both ends.
    pub shares: Shares,
}

impl Strut {
    /// Whether this is a ball at a node (3MF balls): both nodes are the same, and so are both radii.
    pub fn is_ball(&self) -> bool {
        self.a == self.b
    }

    /// The strut as the active set holds it, for a shape whose unit of length has `1 / quantum` quanta.
    pub(crate) fn record<S: Shape>(&self, quantum: f64) -> StrutRecord {
        let Self { a, b, radius_a, radius_b, caps, shares } = *self;
        let ends = S::ends([radius_a, radius_b], [caps.a, caps.b], self.is_ball(), quantum);
        StrutRecord { a, b, ends, shares: [shares.a, shares.b] }
    }

    /// The strut as a [`Beam`], in quanta.
    pub(super) fn beam(&self) -> Beam {
        Beam {
            a: self.a.map(f64::from),
            b: self.b.map(f64::from),
            radius_a: f64::from(self.radius_a),
            radius_b: f64::from(self.radius_b),
            caps: [self.caps.a, self.caps.b],
        }
    }
}

/// Fractions of a quantum in which the corners of triangles are given: walls far thinner than a quantum keep their two sides. 2³⁰ quanta
/// in fractions fit an `f64` exactly.
pub const QUANTUM_FRACTIONS: i64 = 1 << 20;

/// A triangle of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Corners, in fractions of a quantum ([`QUANTUM_FRACTIONS`]), counter-clockwise seen from outside. The lowest comes first, compared by
    /// z, then y, then x.
    pub corners: [[i64; 3]; 3],
}

impl Triangle {
    /// Largest coordinate, fractions of a quantum: that of 2³⁰ quanta.
    pub const MAX_COORDINATE: i64 = QUANTUM_FRACTIONS << 30;

    /// The triangle of these corners, in the order that a file has.
    pub fn new(mut corners: [[i64; 3]; 3]) -> Self {
        let lowest = (0..3).min_by_key(|corner| corner_key(corners[*corner])).unwrap_or(0);
        corners.rotate_left(lowest);
        Self { corners }
    }

    /// # Errors
    /// A text if a coordinate is beyond [`Triangle::MAX_COORDINATE`].
    pub(super) fn check_range(&self) -> Result<(), String> {
        let is_far = |at: &i64| !(-Self::MAX_COORDINATE..=Self::MAX_COORDINATE).contains(at);
        if self.corners.as_flattened().iter().any(is_far) {
            return Err(format!("{self:?} reaches beyond ±2³⁰ quanta"));
        }
        Ok(())
    }

    /// The smallest box of whole quanta around it. Its coordinates must be in range.
    pub(super) fn bounds(&self) -> Bounds {
        let along = |axis: usize| self.corners.map(|corner| corner[axis]);
        let low = |axis| along(axis).into_iter().fold(i64::MAX, i64::min).div_euclid(QUANTUM_FRACTIONS) as i32;
        let high = |axis| -(-along(axis).into_iter().fold(i64::MIN, i64::max)).div_euclid(QUANTUM_FRACTIONS) as i32;
        Bounds { min: [0, 1, 2].map(low), max: [0, 1, 2].map(high) }
    }
}

/// The order of corners in a file: by z, then y, then x.
pub(super) fn corner_key(corner: [i64; 3]) -> [i64; 3] {
    [corner[2], corner[1], corner[0]]
}

/// The order of nodes in a file: by z, then y, then x.
pub(super) fn node_key(node: [i32; 3]) -> [i32; 3] {
    [node[2], node[1], node[0]]
}

/// An axis-aligned box, quanta. Both corners belong to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub struct Bounds {
    /// Lowest corner.
    pub min: [i32; 3],
    /// Highest corner.
    pub max: [i32; 3],
}

impl Bounds {
    /// The bounds of nothing.
    pub(super) const EMPTY: Self = Self { min: [i32::MAX; 3], max: [i32::MIN; 3] };

    /// What belongs to both; `None` if nothing does.
    pub(super) fn common(&self, other: &Self) -> Option<Self> {
        let min = [0, 1, 2].map(|axis| self.min[axis].max(other.min[axis]));
        let max = [0, 1, 2].map(|axis| self.max[axis].min(other.max[axis]));
        (0..3).all(|axis| min[axis] <= max[axis]).then_some(Self { min, max })
    }

    /// The bounds of both.
    pub(super) fn joined(mut self, other: &Self) -> Self {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
        self
    }

    /// Height of the lower end, micrometres.
    pub(super) fn bottom_um(&self, quantum_um: f64) -> f64 {
        f64::from(self.min[2]) * quantum_um
    }

    /// The bounds with one more strut, including its radii; `None` if it reaches beyond ±2³¹ quanta.
    pub(super) fn with(mut self, strut: &Strut) -> Option<Self> {
        for (node, radius) in [(strut.a, strut.radius_a), (strut.b, strut.radius_b)] {
            for (axis, at) in node.into_iter().enumerate() {
                self.min[axis] = self.min[axis].min(at.checked_sub_unsigned(radius)?);
                self.max[axis] = self.max[axis].max(at.checked_add_unsigned(radius)?);
            }
        }
        Some(self)
    }
}

/// Position of the part on the plate.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub enum Placement {
    /// The middle of the footprint is at the middle of the plate.
    Centred,
    /// The middle of the footprint is at this point, measured from the corner of the build area with the lowest x and y.
    At {
        /// Millimetres along x.
        x_mm: f64,
        /// Millimetres along y.
        y_mm: f64,
    },
}

/// The header of a build file: its bodies, and everything that is needed before the first chunk is read.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct Header {
    /// Length of one quantum, micrometres, 0.001 to 1000.
    pub quantum_um: f64,
    /// Bounds of all bodies; of a clipped lattice, of what is left. A convolution may bulge beyond them, by less than its support minus its smallest radius.
    pub bounds: Bounds,
    /// Height of the lowest solid point, which is on the plate, micrometres. Exact for a union; for a convolution at most about 1 µm
    /// too high.
    pub bottom_um: f64,
    /// Position of the part on the plate.
    pub placement: Placement,
    /// SHA-256 of the source files' bytes, in the order they were given.
    pub source_digest: [u8; 32],
    /// Name of the source, for people; at most 255 bytes.
    pub source_name: String,
    /// Its materials; `None` if it does not name any.
    pub materials: Option<Materials>,
    /// The bodies, 1 to [`Header::MAX_BODIES`]. The part is their union, but for clips: each of them clips the lattice before it.
    pub bodies: Vec<BodyHeader>,
}

impl Header {
    /// Most bodies in a part: the headers of so many lattices and clips take 2 KiB of the 16 that a header may have.
    pub const MAX_BODIES: usize = 22;

    /// The first bodies, if they are lattices of different materials that are joined into one solid: two or more.
    pub fn joined(&self) -> Option<Range<usize>> {
        let is_whole = |number: usize| {
            matches!(self.bodies[number], BodyHeader::Lattice(_))
                && !matches!(self.bodies.get(number + 1), Some(BodyHeader::Clip(_)))
        };
        let end = (0..self.bodies.len()).take_while(|number| is_whole(*number)).count();
        (self.materials.is_some() && end > 1).then_some(0..end)
    }

    /// The lattices among the bodies, in order. A place here is not that of the body: to pair bodies with something else, go through
    /// [`Header::bodies`].
    pub fn lattices(&self) -> impl Iterator<Item = &Lattice> {
        self.bodies.iter().filter_map(BodyHeader::lattice)
    }
}

/// Bounds of what is printed of these bodies: of a clipped lattice, what is left.
pub(super) fn printed_bounds(bodies: &[BodyHeader]) -> Bounds {
    let is_clipped = |body: usize| matches!(bodies.get(body + 1), Some(BodyHeader::Clip(_)));
    let printed = bodies.iter().enumerate().filter(|(body, _)| !is_clipped(*body));
    printed.fold(Bounds::EMPTY, |bounds, (_, body)| bounds.joined(body.bounds()))
}

/// The header of one body, by kind.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub enum BodyHeader {
    /// Struts and balls of one joint.
    Lattice(Lattice),
    /// What triangles enclose.
    Surface(Surface),
    /// What patches enclose.
    Relief(Relief),
    /// What clips the lattice before it.
    Clip(Clip),
}

impl BodyHeader {
    /// Bounds of the body, quanta; those of a clip are of what it leaves.
    pub fn bounds(&self) -> &Bounds {
        match self {
            Self::Lattice(lattice) => &lattice.bounds,
            Self::Surface(surface) => &surface.bounds,
            Self::Relief(relief) => &relief.bounds,
            Self::Clip(clip) => &clip.bounds,
        }
    }

    /// The lattice, if it is one.
    pub(crate) fn lattice(&self) -> Option<&Lattice> {
        match self {
            Self::Lattice(lattice) => Some(lattice),
            Self::Surface(_) | Self::Relief(_) | Self::Clip(_) => None,
        }
    }

    /// Number of primitives: struts and balls, triangles, or patches.
    pub(crate) fn total(&self) -> u64 {
        match self {
            Self::Lattice(lattice) => lattice.total(),
            Self::Surface(surface) => surface.triangle_count,
            Self::Relief(relief) => relief.patch_count,
            Self::Clip(clip) => clip.surface.triangle_count,
        }
    }

    /// Bounds of z of its primitives, quanta.
    pub(super) fn z_reach(&self) -> [i32; 2] {
        match self {
            Self::Relief(relief) => relief.z_reach,
            Self::Clip(Clip { surface, .. }) => [surface.bounds.min[2], surface.bounds.max[2]],
            Self::Lattice(_) | Self::Surface(_) => [self.bounds().min[2], self.bounds().max[2]],
        }
    }

    /// Its height maps.
    pub(super) fn maps(&self) -> &[MapHeader] {
        match self {
            Self::Lattice(_) | Self::Surface(_) | Self::Clip(_) => &[],
            Self::Relief(relief) => &relief.maps,
        }
    }

    /// Whether the lowest solid point is known exactly from the primitives alone.
    pub(super) fn is_exact(&self) -> bool {
        match self {
            Self::Lattice(lattice) => lattice.joint == Joint::Union,
            Self::Surface(_) | Self::Relief(_) => true,
            Self::Clip(_) => false,
        }
    }
}

/// The header of a surface. A point is solid if the surface goes around it more often counter-clockwise than clockwise, that is, if its
/// winding number is above 0.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct Surface {
    /// The smallest box of whole quanta around all triangles.
    pub bounds: Bounds,
    /// Number of triangles.
    pub triangle_count: u64,
}

impl Surface {
    /// The header of these triangles.
    pub fn of(triangles: &[Triangle]) -> Self {
        let bounds = triangles.iter().fold(Bounds::EMPTY, |bounds, triangle| bounds.joined(&triangle.bounds()));
        Self { bounds, triangle_count: triangles.len() as u64 }
    }
}

/// Which part of a lattice a clip leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub enum Keeps {
    /// What lies within the surface.
    Inside,
    /// What lies outside of it.
    Outside,
}

/// The header of a clip: a surface that leaves one side of the lattice before it, and is not printed itself.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct Clip {
    /// What it leaves.
    pub keeps: Keeps,
    /// A box around what is left. Its z is that of the lowest and highest point, found as [`Header::bottom_um`] is; a convolution may bulge
    /// beyond its sides.
    pub bounds: Bounds,
    /// The surface.
    pub surface: Surface,
}

impl Clip {
    /// The most that [`Clip::bounds`] may be: those of the lattice, along z with its bulge, and within the surface if that is kept. `None` if
    /// nothing can be left.
    pub(super) fn limits(&self, lattice: &Lattice, quantum_um: f64) -> Option<Bounds> {
        let mut bounds = lattice.bounds;
        // The cast saturates.
        let bulge = (lattice.bulge_um(quantum_um) / quantum_um).ceil() as i32;
        bounds.min[2] = bounds.min[2].saturating_sub(bulge);
        bounds.max[2] = bounds.max[2].saturating_add(bulge);
        match self.keeps {
            Keeps::Inside => bounds.common(&self.surface.bounds),
            Keeps::Outside => Some(bounds),
        }
    }
}

/// The header of a lattice.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct Lattice {
    /// How the struts are joined.
    pub joint: Joint,
    /// Bounds of all struts, including their radii.
    pub bounds: Bounds,
    /// Smallest and largest radius, quanta.
    pub radius_range: [u32; 2],
    /// Number of struts, without balls.
    pub strut_count: u64,
    /// Number of balls.
    pub ball_count: u64,
    /// Number of distinct nodes, or 0 if the writer could not count them with limited memory.
    pub node_count: u64,
    /// Whether any strut is less than whole of the body's material.
    pub is_graded: bool,
}

impl Lattice {
    /// Greatest distance from its axis at which a strut has any effect, micrometres: the support, or the largest radius.
    pub fn reach_um(&self, quantum_um: f64) -> f64 {
        self.joint.support_um().unwrap_or(f64::from(self.radius_range[1]) * quantum_um)
    }

    /// Upper limit of how far the solid extends beyond `bounds`, micrometres: the support minus the smallest radius, or 0 for a union.
    pub(crate) fn bulge_um(&self, quantum_um: f64) -> f64 {
        self.joint.support_um().map_or(0.0, |support_um| support_um - f64::from(self.radius_range[0]) * quantum_um)
    }

    /// Struts and balls together.
    pub fn total(&self) -> u64 {
        self.strut_count.saturating_add(self.ball_count)
    }

    /// [`Lattice::reach_um`] in whole quanta, rounded up: overestimating activity is safe.
    pub(super) fn reach_quanta(&self, quantum_um: f64) -> i64 {
        (self.reach_um(quantum_um) / quantum_um).ceil() as i64
    }
}
