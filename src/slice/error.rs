//! Why a layer could not be computed. `slicer` reports it.

use crate::solid::MAX_RADIUS_SHARE;
use crate::stream::BudgetExceeded;

/// A layer could not be computed.
#[derive(Debug, thiserror::Error)]
pub enum SliceError {
    /// The memory budget is too small.
    #[error(transparent)]
    Budget(#[from] BudgetExceeded),
    /// Struts or triangles could not be read.
    #[error("{0:#}")]
    Source(anyhow::Error),
    /// Struts or triangles contradict header, index or profile; the text says how.
    #[error("{0}; the file is damaged: pack the part again")]
    Damaged(String),
    /// A strut is too thick: one as thick as the support of the kernel has no finite weight.
    #[error(
        "the thickest strut has radius {radius_um} µm, but the kernel's support of {support_um} µm allows less than \
         {MAX_RADIUS_SHARE} of it: pack the part again with a larger support"
    )]
    RadiusTooLarge {
        /// Largest strut radius.
        radius_um: f64,
        /// Support R.
        support_um: f64,
    },
    /// A laser cannot mark the materials of a union whose struts change from one to another.
    #[error(
        "struts that change from one material to another can be divided for a laser only if they are a convolution: pack the part again with \
         --joint convolution or elliptic"
    )]
    GradedUnion,
    /// The bitmap does not have the size and depth of the plan.
    #[error("the bitmap does not have the size and depth of the plan")]
    WrongBitmap,
    /// The contours or vectors of a layer take more memory than the budget has.
    #[error(
        "layer {layer} is too complex: {exceeded}; choose a larger memory budget, fewer threads or a larger pixel pitch"
    )]
    TooComplex {
        /// Number of the layer.
        layer: u32,
        /// What did not fit.
        exceeded: BudgetExceeded,
    },
    /// The tolerance of contours is out of range.
    #[error("a contour tolerance of {0} µm: allowed are 0 and more")]
    BadTolerance(f64),
    /// The number of threads is out of range.
    #[error("{threads} threads: allowed are 1 to {max}")]
    BadThreads {
        /// The number.
        threads: usize,
        /// Largest allowed number.
        max: usize,
    },
    /// The operating system gave no threads; the text is its reason.
    #[error("cannot start threads to slice with: {0}")]
    Threads(String),
}
