//! The only place that touches bincode: fixed-width little-endian values, decoded under a byte limit.
//!
//! bincode is unmaintained (RUSTSEC-2025-0141) and pinned; a successor replaces this file and nothing else.

use bincode::{Decode, Encode, config};

/// No header or index entry is larger; bincode claims lengths against this before it allocates.
const LIMIT_BYTES: usize = 4096;

fn config() -> impl config::Config {
    config::standard().with_little_endian().with_fixed_int_encoding().with_limit::<LIMIT_BYTES>()
}

/// Bytes of `value`.
///
/// # Errors
/// A text where `value` is larger than a header may be.
pub(super) fn encode<T: Encode>(value: &T) -> Result<Vec<u8>, String> {
    let bytes = bincode::encode_to_vec(value, config()).map_err(|error| error.to_string())?;
    if bytes.len() > LIMIT_BYTES {
        return Err(format!("{} bytes encoded, at most {LIMIT_BYTES} are allowed", bytes.len()));
    }
    Ok(bytes)
}

/// The value that fills `bytes` exactly.
///
/// # Errors
/// A text that says why these bytes are no such value.
pub(super) fn decode<T: Decode<()>>(bytes: &[u8]) -> Result<T, String> {
    let (value, used) = bincode::decode_from_slice(bytes, config()).map_err(|error| error.to_string())?;
    if used != bytes.len() {
        return Err(format!("{} bytes are left over", bytes.len() - used));
    }
    Ok(value)
}
