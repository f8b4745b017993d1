//! Why a part cannot be printed. `tests/strangers.rs` and `tests/check/` show the texts.

use crate::buildfile::BuildFileError;
use crate::device::encoding::WrongDepth;
use crate::link::message::Encoding;
use crate::slice::scan::FillError;
use crate::slice::{PlanError, SliceError};
use crate::stream::{BudgetExceeded, StreamError};
use crate::text::shell_word;
use layerd_wire::encoding::VectorEncodeError;

/// Why a part cannot be printed on a machine, or a layer of it not be computed. Each text says what to do.
#[derive(Debug, thiserror::Error)]
pub enum PartError {
    /// The file cannot be read, is not a build file, or is damaged.
    #[error(transparent)]
    File(#[from] BuildFileError),
    /// The part does not fit the machine.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// It is of several materials, and machines print one.
    #[error(
        "the part is of {} materials ({}), and this machine prints one: pack it again with --materials {}, or write the layers of each material with \
         `layerctl slice`",
        .0.len(), .0.join(", "), together(.0)
    )]
    Materials(Vec<String>),
    /// It needs more memory than the budget.
    #[error(
        "this job needs {} of memory, but memory_budget is {}: raise it to at least {} in the daemon's configuration",
        mebibytes(*.need_bytes), mebibytes(*.limit_bytes), mebibytes(*.need_bytes)
    )]
    Memory {
        /// Peak memory of the print path.
        need_bytes: u64,
        /// The budget.
        limit_bytes: u64,
    },
    /// The budget has no room for it now.
    #[error(transparent)]
    Budget(#[from] BudgetExceeded),
    /// A layer could not be computed.
    #[error(transparent)]
    Slice(SliceError),
    /// A layer could not be filled with scan vectors.
    #[error(transparent)]
    Fill(#[from] FillError),
    /// A layer could not be encoded.
    #[error(transparent)]
    Encoding(#[from] WrongDepth),
    /// A layer of scan vectors could not be encoded.
    #[error(transparent)]
    Vectors(#[from] VectorEncodeError),
    /// An encoding of pictures was chosen for a layer of scan vectors.
    #[error("scan vectors cannot be written as {0:?}")]
    NoVectors(Encoding),
    /// Layers could not be computed ahead.
    #[error(transparent)]
    Stream(#[from] StreamError),
}

/// Names that put all materials together, for a shell.
fn together(names: &[String]) -> String {
    let first = names.first().map_or("", String::as_str);
    let pairs: Vec<_> = names.iter().map(|name| format!("{name}={first}")).collect();
    shell_word(&pairs.join(",")).into_owned()
}

/// Rounded up, so that this budget is enough.
fn mebibytes(bytes: u64) -> String {
    format!("{}MiB", bytes.div_ceil(1 << 20))
}

impl PartError {
    /// What is damaged in the build file and how, without a remedy; `None` where it is not damaged.
    pub fn damage(&self) -> Option<String> {
        match self {
            Self::File(error) => error.damage(),
            Self::Slice(SliceError::Damaged(damage)) => Some(damage.clone()),
            _ => None,
        }
    }

    /// What did not fit the memory budget while a layer was computed; `None` if it was something else.
    pub fn shortage(&self) -> Option<&BudgetExceeded> {
        match self {
            Self::Slice(SliceError::TooComplex { exceeded, .. })
            | Self::Fill(FillError::Slice(SliceError::TooComplex { exceeded, .. })) => Some(exceeded),
            _ => None,
        }
    }
}

impl From<SliceError> for PartError {
    fn from(error: SliceError) -> Self {
        match error {
            // The struts come from a build file.
            SliceError::Source(source) => {
                source.downcast().map_or_else(|source| Self::Slice(SliceError::Source(source)), Self::File)
            }
            error => Self::Slice(error),
        }
    }
}
