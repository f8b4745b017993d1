//! Why a layer cannot be encoded or decoded; see [`encode`](super::encode) and [`Decoder`](super::Decoder).

/// The bytes given are not whole rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{bytes} bytes are not a whole number of rows of {row_bytes} bytes")]
pub struct PartialRow {
    /// Bytes given.
    pub bytes: usize,
    /// Bytes of a row.
    pub row_bytes: usize,
}

/// Bytes that are not a picture of the agreed size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// A code does not exist, or leads out of the row.
    #[error("a code that does not exist or leads out of its row")]
    BadCode,
    /// The bytes end before the picture does.
    #[error("the bytes end before the last row")]
    TooFewRows,
    /// There are bytes after the last row.
    #[error("there are bytes after the last row")]
    TooManyRows,
    /// Padding bits are not 0.
    #[error("padding bits are not 0")]
    BadPadding,
}
