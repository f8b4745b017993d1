//! Small values as bytes: little endian, integers of fixed width, decoded with a limit on length.
//!
//! Only this file uses bincode, which is unmaintained (RUSTSEC-2025-0141) and pinned, so that it can be replaced here.
//! `buildfile/store/format.rs` and `job/journal` encode with it.

use bincode::config::{Configuration, Fixint, LittleEndian};
use bincode::error::DecodeError;
use bincode::{Decode, Encode};

/// Bytes that are not a value of the expected type.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub(crate) struct CodecError(String);

/// Encodes a value.
///
/// # Errors
/// [`CodecError`] if a length does not fit the format, which is not possible with the types of this crate.
pub(crate) fn encode<T: Encode>(value: &T) -> Result<Vec<u8>, CodecError> {
    bincode::encode_to_vec(value, format()).map_err(|error| CodecError(error.to_string()))
}

/// Decodes a value that takes all of `bytes`. At most `LIMIT` bytes are allocated, whatever lengths the bytes state.
///
/// # Errors
/// [`CodecError`] if the bytes are not a `T`, need more than `LIMIT` bytes, or continue after the value.
pub(crate) fn decode<T: Decode<()>, const LIMIT: usize>(bytes: &[u8]) -> Result<T, CodecError> {
    let config = format().with_limit::<LIMIT>();
    let (value, used) = bincode::decode_from_slice(bytes, config).map_err(|error| CodecError(text(&error)))?;
    if used == bytes.len() { Ok(value) } else { Err(CodecError(format!("{} bytes are left over", bytes.len() - used))) }
}

/// A message for people. The library's own messages are meant for programmers.
fn text(error: &DecodeError) -> String {
    match error {
        DecodeError::UnexpectedEnd { .. } => "it ends too early".into(),
        DecodeError::LimitExceeded => "it states a length that is not allowed here".into(),
        DecodeError::UnexpectedVariant { type_name, found, .. } => format!("{found} is not a kind of {type_name}"),
        DecodeError::Utf8 { .. } => "it contains a text that is not UTF-8".into(),
        other => other.to_string(),
    }
}

fn format() -> Configuration<LittleEndian, Fixint> {
    bincode::config::standard().with_fixed_int_encoding()
}
