//! Little-endian reading and writing. [`codec`](super::codec) and [`handshake`](super::handshake) use it.

use alloc::string::String;
use alloc::vec::Vec;

/// A malformed payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The payload ends inside a field.
    #[error("the payload ends before {field}")]
    Short {
        /// The field.
        field: &'static str,
    },
    /// Bytes left over after the last field.
    #[error("{bytes} bytes are left over after the last field")]
    Trailing {
        /// How many.
        bytes: usize,
    },
    /// A field has a value without a meaning.
    #[error("{field} = {value} has no meaning")]
    BadValue {
        /// The field.
        field: &'static str,
        /// What it held.
        value: u32,
    },
    /// A request of an unknown kind, or with malformed fields. The device answers it with `Refused(Unknown)`.
    #[error("request {number} is of an unknown kind or malformed")]
    BadRequest {
        /// The request's number.
        number: u32,
    },
    /// A report of an unknown kind. The host ignores it.
    #[error("report of the unknown kind {kind}")]
    UnknownReport {
        /// The kind's code.
        kind: u8,
    },
    /// A welcome of a version that is not known here. Nothing after the version is read.
    #[error("version {version} of the protocol is not known here")]
    OtherVersion {
        /// The version it names.
        version: u16,
    },
    /// A machine of a kind that is not known here. Nothing after the kind is read.
    #[error("machines of kind {kind} are not known here")]
    UnknownMachine {
        /// The kind's code.
        kind: u8,
    },
    /// A text that is not UTF-8.
    #[error("{field} is not UTF-8")]
    BadText {
        /// The field.
        field: &'static str,
    },
}

/// Takes fields off the front of a payload.
pub(super) struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(super) fn new(payload: &'a [u8]) -> Self {
        Self { rest: payload }
    }

    fn take(&mut self, length: usize, field: &'static str) -> Result<&'a [u8], WireError> {
        let (head, rest) = self.rest.split_at_checked(length).ok_or(WireError::Short { field })?;
        self.rest = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], WireError> {
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or(WireError::Short { field })?;
        self.rest = rest;
        Ok(*head)
    }

    pub(super) fn u8(&mut self, field: &'static str) -> Result<u8, WireError> {
        self.array::<1>(field).map(|[byte]| byte)
    }

    pub(super) fn u16(&mut self, field: &'static str) -> Result<u16, WireError> {
        self.array(field).map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self, field: &'static str) -> Result<u32, WireError> {
        self.array(field).map(u32::from_le_bytes)
    }

    pub(super) fn i32(&mut self, field: &'static str) -> Result<i32, WireError> {
        self.array(field).map(i32::from_le_bytes)
    }

    pub(super) fn u64(&mut self, field: &'static str) -> Result<u64, WireError> {
        self.array(field).map(u64::from_le_bytes)
    }

    pub(super) fn bool(&mut self, field: &'static str) -> Result<bool, WireError> {
        match self.u8(field)? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(WireError::BadValue { field, value: other.into() }),
        }
    }

    /// A presence byte, then the value if it is 1.
    pub(super) fn option<T>(
        &mut self,
        field: &'static str,
        read: impl FnOnce(&mut Self) -> Result<T, WireError>,
    ) -> Result<Option<T>, WireError> {
        if self.bool(field)? { read(self).map(Some) } else { Ok(None) }
    }

    /// A count of at most `limit`, then that many values.
    pub(super) fn list<T>(
        &mut self,
        field: &'static str,
        limit: usize,
        mut read: impl FnMut(&mut Self) -> Result<T, WireError>,
    ) -> Result<Vec<T>, WireError> {
        let count = self.u8(field)?;
        if usize::from(count) > limit {
            return Err(WireError::BadValue { field, value: count.into() });
        }
        (0..count).map(|_| read(self)).collect()
    }

    /// A length of at most `limit`, then UTF-8.
    pub(super) fn text(&mut self, field: &'static str, limit: usize) -> Result<String, WireError> {
        let length = self.u8(field)?;
        if usize::from(length) > limit {
            return Err(WireError::BadValue { field, value: length.into() });
        }
        let bytes = self.take(length.into(), field)?;
        core::str::from_utf8(bytes).map(Into::into).map_err(|_| WireError::BadText { field })
    }

    pub(super) fn rest(self) -> &'a [u8] {
        self.rest
    }

    /// Refuses bytes left over.
    pub(super) fn end(self) -> Result<(), WireError> {
        if self.rest.is_empty() { Ok(()) } else { Err(WireError::Trailing { bytes: self.rest.len() }) }
    }
}

/// Appends fields to a payload.
#[derive(Default)]
pub(super) struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    pub(super) fn u8(&mut self, value: u8) -> &mut Self {
        self.bytes.push(value);
        self
    }

    pub(super) fn u16(&mut self, value: u16) -> &mut Self {
        self.raw(&value.to_le_bytes())
    }

    pub(super) fn u32(&mut self, value: u32) -> &mut Self {
        self.raw(&value.to_le_bytes())
    }

    pub(super) fn i32(&mut self, value: i32) -> &mut Self {
        self.raw(&value.to_le_bytes())
    }

    pub(super) fn u64(&mut self, value: u64) -> &mut Self {
        self.raw(&value.to_le_bytes())
    }

    pub(super) fn bool(&mut self, value: bool) -> &mut Self {
        self.u8(value.into())
    }

    pub(super) fn raw(&mut self, bytes: &[u8]) -> &mut Self {
        self.bytes.extend_from_slice(bytes);
        self
    }

    pub(super) fn option<T>(&mut self, value: Option<&T>, write: impl FnOnce(&mut Self, &T)) -> &mut Self {
        self.bool(value.is_some());
        if let Some(value) = value {
            write(self, value);
        }
        self
    }

    /// Count and values. Values beyond `limit` (at most 255) are dropped.
    pub(super) fn list<T>(&mut self, values: &[T], limit: u8, mut write: impl FnMut(&mut Self, &T)) -> &mut Self {
        let count = u8::try_from(values.len()).unwrap_or(u8::MAX).min(limit);
        self.u8(count);
        for value in &values[..usize::from(count)] {
            write(self, value);
        }
        self
    }

    /// Length and UTF-8. A text longer than `limit` bytes (at most 255) is cut at a character boundary.
    pub(super) fn text(&mut self, text: &str, limit: u8) -> &mut Self {
        let end = (0..=usize::from(limit).min(text.len())).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
        let length = u8::try_from(end).unwrap_or(limit);
        self.u8(length).raw(&text.as_bytes()[..end])
    }

    pub(super) fn finish(&mut self) -> Vec<u8> {
        core::mem::take(&mut self.bytes)
    }
}
