//! The numbers of a layer of vectors one by one, as bytes: plain varints, or coded with the [`Model`](super::model).
//!
//! A signed number is written as 2n, or −2n − 1 if it is negative ("zigzag").

use alloc::boxed::Box;
use alloc::vec::Vec;

use super::super::range::{RangeDecoder, RangeEncoder};
use super::model::Model;
use super::{VectorEncoding, VectorError};

/// What a number is. The coder keeps statistics for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Field {
    /// A number of the table of laser parameters or of a frame.
    Table,
    /// The begin of a run, after a run of some kind.
    Head {
        /// Number of the kind before.
        after: u8,
    },
    /// Difference along an axis from the laser's place to the start of a path, or to a point.
    Jump {
        /// 0 for x, 1 for y.
        axis: u8,
    },
    /// Change of the difference along an axis from one point of a path to the next.
    Step {
        /// 0 for x, 1 for y.
        axis: u8,
        /// What is known of the path so far: statistics of the size, below [`Field::STEP_SIZES`].
        size: u8,
        /// Statistics of the sign, below [`Field::STEP_SIGNS`].
        sign: u8,
    },
    /// Change of the low end of a hatch. The lowest bit says whether a [`Field::Turn`] follows.
    Low,
    /// Change of line and direction of a hatch.
    Turn,
    /// Change of the high end of a hatch.
    High,
}

impl Field {
    /// Number of statistics for the size of a step of each axis.
    pub(super) const STEP_SIZES: usize = 25;
    /// Number of statistics for the sign of a step.
    pub(super) const STEP_SIGNS: usize = 27 + 81;
}

/// A signed number without sign.
pub(super) fn zigzag(number: i32) -> u32 {
    (number.cast_unsigned() << 1) ^ (number >> 31).cast_unsigned()
}

/// The signed number of [`zigzag`].
pub(super) fn from_zigzag(number: u32) -> i32 {
    ((number >> 1) ^ (number & 1).wrapping_neg()).cast_signed()
}

/// Writes numbers.
#[derive(Debug)]
pub(super) enum SymbolWriter<'a> {
    Plain(&'a mut Vec<u8>),
    Coded(RangeEncoder<'a>, Box<Model>),
}

impl<'a> SymbolWriter<'a> {
    /// Writes into `bytes`, which are cleared.
    pub(super) fn new(encoding: VectorEncoding, bytes: &'a mut Vec<u8>) -> Self {
        bytes.clear();
        match encoding {
            VectorEncoding::Plain => Self::Plain(bytes),
            VectorEncoding::Coded => Self::Coded(RangeEncoder::new(bytes), Box::default()),
        }
    }

    pub(super) fn put(&mut self, field: Field, number: u32) {
        match self {
            Self::Plain(bytes) => put_varint(bytes, number),
            Self::Coded(coder, model) => model.put(field, number, coder),
        }
    }

    pub(super) fn written_bytes(&self) -> usize {
        match self {
            Self::Plain(bytes) => bytes.len(),
            Self::Coded(coder, _) => coder.written_bytes(),
        }
    }

    pub(super) fn finish(self) {
        if let Self::Coded(coder, _) = self {
            coder.finish();
        }
    }
}

fn put_varint(bytes: &mut Vec<u8>, mut number: u32) {
    while number > 0x7f {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// Takes numbers from bytes that arrive in pieces.
#[derive(Debug)]
pub(super) enum SymbolReader {
    Plain(Varint),
    Coded(RangeDecoder, Box<Model>),
}

/// The digits of a varint so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Varint {
    number: u32,
    digits: u32,
}

impl Varint {
    /// Takes bytes until the number is complete; `None` if they end before.
    fn take(&mut self, bytes: &mut &[u8]) -> Result<Option<u32>, VectorError> {
        while let Some((&byte, rest)) = bytes.split_first() {
            *bytes = rest;
            let digit = u32::from(byte & 0x7f);
            // The fifth digit has the highest 4 of 32 bits. A last digit of 0 would be a second way to write a number.
            if self.digits == 4 && byte > 0x0f || self.digits > 0 && byte == 0 {
                return Err(VectorError::BadCode);
            }
            self.number |= digit << (7 * self.digits);
            self.digits += 1;
            if byte & 0x80 == 0 {
                return Ok(Some(core::mem::take(self).number));
            }
        }
        Ok(None)
    }
}

impl SymbolReader {
    pub(super) fn new(encoding: VectorEncoding) -> Self {
        match encoding {
            VectorEncoding::Plain => Self::Plain(Varint::default()),
            VectorEncoding::Coded => Self::Coded(RangeDecoder::new(), Box::default()),
        }
    }

    /// The next number, taking `bytes` as needed; `None` if more bytes are needed. `more` is the number of bytes of the layer that come
    /// after `bytes`.
    pub(super) fn take(&mut self, field: Field, bytes: &mut &[u8], more: u32) -> Result<Option<u32>, VectorError> {
        let number = match self {
            Self::Plain(varint) => varint.take(bytes)?,
            Self::Coded(coder, model) => {
                coder.fill(bytes);
                if bytes.is_empty() && more == 0 {
                    coder.end();
                }
                if coder.is_ready(Model::STEP_BYTES) { Some(model.take(field, coder)?) } else { None }
            }
        };
        let overdrawn = match self {
            Self::Plain(_) => number.is_none() && more == 0,
            Self::Coded(coder, _) => coder.is_overdrawn(),
        };
        if overdrawn { Err(VectorError::TooFewBytes) } else { Ok(number) }
    }

    /// Checks that nothing is left after the layer's last number. `more` is the number of bytes that were not given to
    /// [`take`](Self::take).
    pub(super) fn check_end(&self, more: u32) -> Result<(), VectorError> {
        match self {
            _ if more > 0 => Err(VectorError::TooManyBytes),
            Self::Coded(coder, _) if coder.bytes_left() > 0 => Err(VectorError::TooManyBytes),
            Self::Coded(coder, _) if !coder.is_spent() => Err(VectorError::BadCode),
            _ => Ok(()),
        }
    }
}
