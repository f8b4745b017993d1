//! Why the bytes of a layer cannot be decoded.

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
