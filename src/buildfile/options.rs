//! Options of [`pack`](super::pack); `layerctl pack` sets them.

use std::num::NonZero;

use super::model::Placement;

/// How to pack.
#[derive(Clone, Debug, PartialEq)]
pub struct PackOptions {
    /// Leave out everything that is not a lattice, instead of refusing the source.
    pub lattice_only: bool,
    /// How struts are joined. `None` is the default of the source's format: union for 3MF, convolution for edge text.
    pub blend: Option<BlendChoice>,
    /// Rotation about x, then y, then z, degrees.
    pub rotate_deg: [f64; 3],
    /// Factors on lengths along x, y and z, applied after the rotation; greater than 0. Radii get the mean of the smallest and the
    /// largest factor; a part is refused if a surface would then be more than 25 µm off the stretched one.
    pub scale: [f64; 3],
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
            rotate_deg: [0.0; 3],
            scale: [1.0; 3],
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
