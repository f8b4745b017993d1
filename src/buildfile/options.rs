//! Options of [`pack`](super::pack); `layerctl pack` sets them.

use std::num::NonZero;
use std::path::PathBuf;

use super::model::Placement;
use super::relief::Tile;

/// How to pack.
#[derive(Clone, Debug, PartialEq)]
pub struct PackOptions {
    /// Leave out everything that is not a lattice, instead of refusing the source.
    pub lattice_only: bool,
    /// How struts are joined. `None` is the default of the source's format: union for 3MF, convolution for edge text.
    pub blend: Option<BlendChoice>,
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
    /// No rotation, no scale, the blend of the source's format, centred; a quantum of 1 µm, 256 MiB of memory, one thread.
    fn default() -> Self {
        Self {
            lattice_only: false,
            blend: None,
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

/// A choice of blend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BlendChoice {
    /// A convolution surface.
    Convolution {
        /// Support R, millimetres, not scaled. `None` is 1.5 times the largest radius.
        support_mm: Option<f64>,
    },
    /// The exact union.
    Union,
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
