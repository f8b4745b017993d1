//! Options of [`pack`](super::pack); `layerctl pack` sets them.

use std::num::NonZero;
use std::path::PathBuf;

use super::error::PackError;
use super::materials::Split;
use super::model::Placement;
use super::relief::Tile;

/// How to pack.
#[derive(Clone, Debug, PartialEq)]
pub struct PackOptions {
    /// Leave out everything that is not a lattice, instead of refusing the source.
    pub lattice_only: bool,
    /// How struts are joined. `None` is the default of the source's format: union for 3MF, convolution for edge text.
    pub joint: Option<JointChoice>,
    /// Names of materials in sources, and what they are to be in the build file. What has no material has the name
    /// [`Materials::UNNAMED`](super::Materials::UNNAMED).
    pub materials: Vec<(String, String)>,
    /// Which material a pixel gets where several meet.
    pub split: Split,
    /// What is done to the surfaces of solids.
    pub relief: ReliefOptions,
    /// Rotation about x, then y, then z, degrees.
    pub rotate_deg: [f64; 3],
    /// Factors on lengths along x, y and z, applied after the rotation; greater than 0. Radii get the mean of the smallest and the
    /// largest factor; a part is refused if a surface would then be more than 25 µm off the stretched one.
    pub scale: [f64; 3],
    /// Longest edge of the box around the rotated part, millimetres, 0.001 to 1000000: in place of `scale`, all lengths and radii get the factor
    /// that it takes. The box is that of the struts, before a mesh clips them, and of triangles, before they are displaced.
    pub size_mm: Option<f64>,
    /// Position of the part on the plate.
    pub placement: Placement,
    /// Length of one quantum, micrometres, 0.001 to 1000. Coordinates and radii are rounded to multiples of it.
    pub quantum_um: f64,
    /// Memory of the external sort, bytes.
    pub memory_bytes: u64,
    /// Threads that parse and sort, and equally many, at most 4, that compress. The file does not depend on their number.
    pub threads: NonZero<usize>,
}

impl Default for PackOptions {
    /// No rotation, no scale, the joint of the source's format, centred; a quantum of 1 µm, 256 MiB of memory, one thread.
    fn default() -> Self {
        Self {
            lattice_only: false,
            joint: None,
            materials: Vec::new(),
            split: Split::default(),
            relief: ReliefOptions::default(),
            rotate_deg: [0.0; 3],
            scale: [1.0; 3],
            size_mm: None,
            placement: Placement::Centred,
            quantum_um: 1.0,
            memory_bytes: 256 << 20,
            threads: NonZero::<usize>::MIN,
        }
    }
}

/// A choice of joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointChoice {
    /// A convolution surface.
    Convolution {
        /// Support R, millimetres, not scaled. `None` is 1.5 times the largest radius.
        support_mm: Option<f64>,
    },
    /// The exact union.
    Union,
    /// A convolution surface of each material, joined by elliptic arcs.
    Elliptic {
        /// As that of a convolution.
        support_mm: Option<f64>,
        /// Where the blend begins.
        begins: BlendBegin,
    },
}

/// Where a blend of materials begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BlendBegin {
    /// At the least field of the first and of the second material, as a share of the other's.
    Least([f64; 2]),
    /// At these points in the coordinates of the source, millimetres: on the surface of the first of two materials, and on that of the second.
    Points([[f64; 3]; 2]),
}

impl JointChoice {
    /// Elliptic arcs that begin at these angles, degrees: θ₁ from 0.1 to 44.9, and θ₂ from 45.1 to 89.9, by default 90 − θ₁. The smaller θ₁, the wider is
    /// the blend (heterogeneous lattices, Eq. 3.4).
    ///
    /// # Errors
    /// [`PackError`] if an angle is out of range.
    pub fn elliptic(support_mm: Option<f64>, theta1_deg: f64, theta2_deg: Option<f64>) -> Result<Self, PackError> {
        let theta2_deg = theta2_deg.unwrap_or(90.0 - theta1_deg);
        for (name, angle, range) in [("--theta1", theta1_deg, 0.1..=44.9), ("--theta2", theta2_deg, 45.1..=89.9)] {
            if !range.contains(&angle) {
                let (least, most) = range.into_inner();
                return Err(PackError::Option(format!("{name} {angle}: allowed is {least} to {most} degrees")));
            }
        }
        let [tangent, cotangent] = [theta1_deg, 90.0 - theta2_deg].map(|angle| angle.to_radians().tan());
        Ok(Self::Elliptic { support_mm, begins: BlendBegin::Least([cotangent, tangent]) })
    }

    /// The support that was asked for, millimetres.
    pub(super) fn support_mm(self) -> Option<f64> {
        match self {
            Self::Convolution { support_mm } | Self::Elliptic { support_mm, .. } => support_mm,
            Self::Union => None,
        }
    }
}

/// What is done to the surfaces of solids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReliefOptions {
    /// The height map that displaces all triangles. It needs `height_mm`.
    pub map: Option<DisplacementOptions>,
    /// Displacement where a map is white, without the offset, millimetres, −1000 to 1000. It replaces what sources state.
    pub height_mm: Option<f64>,
    /// Displacement where a map is black, millimetres, −1000 to 1000. It replaces what sources state.
    pub offset_mm: Option<f64>,
    /// Curve triangles by the normals at their corners.
    pub is_curved: bool,
    /// Print a shell of this thickness inwards from the surface, millimetres, 0.001 to 1000, instead of what it encloses.
    pub shell_mm: Option<f64>,
}

/// A height map.
#[derive(Clone, Debug, PartialEq)]
pub struct DisplacementOptions {
    /// A PNG.
    pub map: PathBuf,
    /// What lies beyond its edges.
    pub tile: Tile,
}

impl ReliefOptions {
    /// Whether all triangles have relief.
    pub(super) fn applies(&self) -> bool {
        self.map.is_some() || self.is_curved || self.shell_mm.is_some()
    }
}
