//! The one place that knows bincode: small values to bytes and back, little endian, integers of fixed width, under a limit.
//!
//! bincode is unmaintained (RUSTSEC-2025-0141) and pinned; whoever replaces it changes this file alone.

use bincode::config::{Configuration, Fixint, LittleEndian};
use bincode::error::DecodeError;
use bincode::{Decode, Encode};

/// Bytes that are not the value they should be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CodecError(String);

/// Writes a value.
///
/// # Errors
/// [`CodecError`] where a length does not fit the format; none of our types can.
pub fn encode<T: Encode>(value: &T) -> Result<Vec<u8>, CodecError> {
    bincode::encode_to_vec(value, format()).map_err(|error| CodecError(error.to_string()))
}

/// Reads a value that takes all of `bytes`; whatever lengths the bytes claim, at most `LIMIT` bytes are allocated.
///
/// # Errors
/// [`CodecError`] where the bytes are not a `T`, claim more than `LIMIT` bytes, or go on after it.
pub fn decode<T: Decode<()>, const LIMIT: usize>(bytes: &[u8]) -> Result<T, CodecError> {
    let config = format().with_limit::<LIMIT>();
    let (value, used) = bincode::decode_from_slice(bytes, config).map_err(|error| CodecError(text(&error)))?;
    if used == bytes.len() { Ok(value) } else { Err(CodecError(format!("{} bytes are left over", bytes.len() - used))) }
}

/// For people; the library's own texts are made for its users' debuggers.
fn text(error: &DecodeError) -> String {
    match error {
        DecodeError::UnexpectedEnd { .. } => "it ends too early".into(),
        DecodeError::LimitExceeded => "it states a length beyond what may stand here".into(),
        DecodeError::UnexpectedVariant { type_name, found, .. } => format!("{found} names no kind of {type_name}"),
        DecodeError::Utf8 { .. } => "a text in it is not UTF-8".into(),
        other => other.to_string(),
    }
}

fn format() -> Configuration<LittleEndian, Fixint> {
    bincode::config::standard().with_fixed_int_encoding()
}
