//! What a pack is asked for.

use std::num::NonZero;

use super::model::Placement;

/// How to pack.
#[derive(Clone, Debug, PartialEq)]
pub struct PackOptions {
    /// Leave out what is not a lattice instead of refusing it.
    pub lattice_only: bool,
    /// How struts are joined; `None` is what the format of the sources means: union for 3MF, convolution for edge text.
    pub blend: Option<BlendChoice>,
    /// Degrees about x, then y, then z.
    pub rotate_deg: [f64; 3],
    /// Factors, greater than 0, on lengths along x, y and z, after turning. Radii get the mean of least and largest factor,
    /// where that leaves no surface more than 25 µm off the stretched one.
    pub scale: [f64; 3],
    /// Where the part stands.
    pub placement: Placement,
    /// Length of one quantum, micrometres, 0.001 to 1000: coordinates and radii are rounded to whole ones.
    pub quantum_um: f64,
    /// Bytes the out-of-core sort may take.
    pub memory_bytes: u64,
    /// Threads that parse and sort, and as many, up to 4, that compress. The file does not depend on their number.
    pub threads: NonZero<usize>,
}

impl Default for PackOptions {
    /// Taken as it stands, joined as its format means it, in the middle of the plate; 256 MiB of memory, one thread.
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

/// The blend as it is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BlendChoice {
    /// A convolution surface; where no support R is named it is 1.5 times the largest radius.
    Convolution {
        /// R in millimetres, after scaling.
        support_mm: Option<f64>,
    },
    /// The exact union.
    Union,
}
