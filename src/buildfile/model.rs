//! What a build file holds, in the quantised units it is stored in.
//!
//! Coordinates are integers in units of [`Header::quantum_um`]: comparison, sorting and sharing of nodes are exact, and a
//! file means the same on every machine.

use bincode::{Decode, Encode};

use crate::solid;

/// Lengths a quantum may have, micrometres: from what no printer can tell to what no part can spare, and coordinates of 2³⁰ of
/// them still reach 1 m.
pub(super) const QUANTA_UM: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

/// Support R as a multiple of the largest radius where none is named: keeps every radius at or below 2R/3.
pub(super) const SUPPORT_FACTOR: f64 = 1.5;

/// How overlapping struts become one solid.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub enum Blend {
    /// Convolution surface (Liu et al. 2021, §3): solid where the summed field reaches [`ISOVALUE`](crate::solid::ISOVALUE).
    Convolution {
        /// Kernel support R in micrometres, one for the whole part; greater than every strut radius / 0.95.
        support_um: f64,
    },
    /// Exact union of beams and balls, as the 3MF beam lattice extension specifies.
    Union,
}

/// The shape of one end of a strut under [`Blend::Union`]; a convolution surface rounds its ends by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Encode, Decode)]
pub enum Cap {
    /// A whole ball of the end's radius round the node.
    #[default]
    Sphere,
    /// The half of that ball which lies beyond the strut's end.
    Hemisphere,
    /// A flat end in the plane through the node, square to the strut.
    Butt,
}

impl From<Cap> for solid::Cap {
    fn from(cap: Cap) -> Self {
        match cap {
            Cap::Sphere => Self::Sphere,
            Cap::Hemisphere => Self::Hemisphere,
            Cap::Butt => Self::Butt,
        }
    }
}

/// The two ends of a strut, `a` and `b`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Encode, Decode)]
pub struct Caps {
    /// The cap at node `a`.
    pub a: Cap,
    /// The cap at node `b`.
    pub b: Cap,
}

/// One strut between two nodes; the radius varies linearly from `a` to `b`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strut {
    /// Node a, quanta. `a` is the lower end, by z, then y, then x.
    pub a: [i32; 3],
    /// Node b, quanta; equal to `a` only in a ball.
    pub b: [i32; 3],
    /// Radius at `a`, quanta, at least 1.
    pub radius_a: u32,
    /// Radius at `b`, quanta, at least 1.
    pub radius_b: u32,
    /// End shapes.
    pub caps: Caps,
}

impl Strut {
    /// Whether this is a ball at a node (3MF balls): a strut of no length, with both radii equal.
    pub fn is_ball(&self) -> bool {
        self.a == self.b
    }

    /// The same as solids know it, in quanta.
    pub(super) fn beam(&self) -> solid::Beam {
        solid::Beam {
            a: self.a.map(f64::from),
            b: self.b.map(f64::from),
            radius_a: f64::from(self.radius_a),
            radius_b: f64::from(self.radius_b),
            caps: [self.caps.a.into(), self.caps.b.into()],
        }
    }
}

/// Nodes in the file's order: z first, so that ascending nodes ascend in z.
pub(super) fn node_key(node: [i32; 3]) -> [i32; 3] {
    [node[2], node[1], node[0]]
}

/// An axis-aligned box in quanta, both corners inside.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub struct Bounds {
    /// Lowest corner.
    pub min: [i32; 3],
    /// Highest corner.
    pub max: [i32; 3],
}

impl Bounds {
    /// Of nothing.
    pub(super) const EMPTY: Self = Self { min: [i32::MAX; 3], max: [i32::MIN; 3] };

    /// Of this and another.
    pub(super) fn joined(mut self, other: &Self) -> Self {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
        self
    }

    /// Where it ends below, micrometres.
    pub(super) fn bottom_um(&self, quantum_um: f64) -> f64 {
        f64::from(self.min[2]) * quantum_um
    }

    /// Of one strut more, with its radii; `None` where it reaches beyond ±2³¹ quanta.
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

/// Where the part stands on the plate.
#[derive(Clone, Copy, Debug, PartialEq, Encode, Decode)]
pub enum Placement {
    /// The middle of the part's footprint at the middle of the plate.
    Centred,
    /// The middle of the part's footprint at this point, millimetres from the corner of the build area with the least x and y.
    At {
        /// Millimetres along x.
        x_mm: f64,
        /// Millimetres along y.
        y_mm: f64,
    },
}

/// The header of a build file: a plate of bodies, and everything a plan needs before the first chunk is read.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct Header {
    /// Length of one quantum in micrometres, e.g. 1.0.
    pub quantum_um: f64,
    /// Bounds of all bodies. A blend may bulge past them, see [`Lattice::bulge_um`].
    pub bounds: Bounds,
    /// Height of the lowest solid point, micrometres: what stands on the plate. Exact for a union; of a convolution at most
    /// about 1 µm above the true one.
    pub bottom_um: f64,
    /// Where the part stands.
    pub placement: Placement,
    /// SHA-256 of the source files' bytes, in the order they were given.
    pub source_digest: [u8; 32],
    /// Name of the source for people; at most 255 bytes.
    pub source_name: String,
    /// What the part is made of, 1 to [`Header::MAX_BODIES`]. Where bodies overlap the part is solid once.
    pub bodies: Vec<BodyHeader>,
}

impl Header {
    /// Most bodies: their headers fit a header's 4096 bytes three times over.
    pub const MAX_BODIES: usize = 16;

    /// The lattices among the bodies, in their order.
    pub fn lattices(&self) -> impl Iterator<Item = &Lattice> {
        self.bodies.iter().map(|BodyHeader::Lattice(lattice)| lattice)
    }
}

/// What one body is.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub enum BodyHeader {
    /// Struts and balls of one blend.
    Lattice(Lattice),
}

/// The header of a lattice.
#[derive(Clone, Debug, PartialEq, Encode, Decode)]
pub struct Lattice {
    /// How its struts are joined.
    pub blend: Blend,
    /// Bounds of all its struts with their radii.
    pub bounds: Bounds,
    /// Least and largest strut radius, quanta.
    pub radius_range: [u32; 2],
    /// Number of struts, balls not counted.
    pub strut_count: u64,
    /// Number of balls.
    pub ball_count: u64,
    /// Number of distinct nodes, or 0 where too many were open at once to be counted.
    pub node_count: u64,
}

impl Lattice {
    /// How far from its skeleton a strut can make anything solid, micrometres: the support, or the largest radius.
    pub fn reach_um(&self, quantum_um: f64) -> f64 {
        match self.blend {
            Blend::Convolution { support_um } => support_um,
            Blend::Union => f64::from(self.radius_range[1]) * quantum_um,
        }
    }

    /// How far the solid may bulge past `bounds`, micrometres: a convolution by less than its support minus the least radius.
    pub fn bulge_um(&self, quantum_um: f64) -> f64 {
        match self.blend {
            Blend::Convolution { support_um } => support_um - f64::from(self.radius_range[0]) * quantum_um,
            Blend::Union => 0.0,
        }
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
