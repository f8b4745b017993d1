//! Why a layer of vectors cannot be encoded or decoded; see [`VectorEncoder`](super::VectorEncoder) and
//! [`VectorDecoder`](super::VectorDecoder).

use super::MarkClass;

/// Vectors that cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VectorEncodeError {
    /// A point lies outside the field.
    #[error("the point ({} µm, {} µm) lies outside the field of {} µm × {} µm", .point_um[0], .point_um[1], .field_um[0], .field_um[1])]
    OutsideField {
        /// The point.
        point_um: [i32; 2],
        /// The field.
        field_um: [u32; 2],
    },
    /// A vector's class is not in the table of laser parameters.
    #[error("a vector of class {0:?}, which has no laser parameters")]
    NoParameters(MarkClass),
    /// The table of laser parameters names a class twice, or the classes are not in the order of their numbers.
    #[error("the laser parameters are not in the order of their classes")]
    BadTable,
    /// A frame whose direction is not a unit vector, with less than 1 µm between lines, or with an origin further than 2.1 m from the field's corner.
    #[error("hatches whose lines have no usable direction, spacing or origin")]
    BadFrame,
    /// A hatch without length, or further than 4.2 m from its frame's origin.
    #[error("a hatch without length, or too far from the origin of its lines")]
    BadHatch,
    /// More vectors than a layer may have.
    #[error("more than {} vectors in a layer", super::MAX_VECTORS)]
    TooManyVectors,
}

/// Bytes that are not a layer of vectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VectorError {
    /// A number that has no meaning at its place, or has more digits than it needs.
    #[error("a number that has no meaning at its place")]
    BadCode,
    /// A vector leaves the field.
    #[error("a vector leaves the field")]
    OutsideField,
    /// A run of a class that is not in the table of laser parameters.
    #[error("vectors of a class without laser parameters")]
    NoParameters,
    /// A frame of hatches without usable direction, spacing or origin; or hatches before the first frame.
    #[error("hatches without a usable frame")]
    BadFrame,
    /// More vectors than a layer may have.
    #[error("too many vectors")]
    TooManyVectors,
    /// The bytes end before the layer does.
    #[error("the bytes end before the layer does")]
    TooFewBytes,
    /// There are bytes after the end of the layer.
    #[error("there are bytes after the end of the layer")]
    TooManyBytes,
}
