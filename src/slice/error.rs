//! Why a layer could not be computed.

use crate::solid::LARGEST_RADIUS_SHARE;
use crate::stream::BudgetExceeded;

/// Why a layer could not be computed.
#[derive(Debug, thiserror::Error)]
pub enum SliceError {
    /// Memory the budget does not have.
    #[error(transparent)]
    Budget(#[from] BudgetExceeded),
    /// The struts could not be read.
    #[error("{0:#}")]
    Source(anyhow::Error),
    /// The struts contradict header or index; the text says how.
    #[error("{0}; the file is damaged: pack the part again")]
    Damaged(String),
    /// A strut as thick as the kernel's support has no finite weight.
    #[error(
        "the thickest strut has radius {radius_um} µm, but the kernel's support of {support_um} µm allows less than \
         {LARGEST_RADIUS_SHARE} of it: pack the part again with a larger support"
    )]
    RadiusTooLarge {
        /// Largest strut radius.
        radius_um: f64,
        /// Support R.
        support_um: f64,
    },
    /// A bitmap of another size or depth than the plan's.
    #[error("the bitmap is not of the size and depth the plan asks for")]
    WrongBitmap,
    /// No thread, or too many.
    #[error("{threads} threads: allowed are 1 to {max}")]
    BadThreads {
        /// Threads asked for.
        threads: usize,
        /// Most that are allowed.
        max: usize,
    },
    /// The operating system gave no threads; the text is its reason.
    #[error("cannot start threads to slice with: {0}")]
    Threads(String),
}
