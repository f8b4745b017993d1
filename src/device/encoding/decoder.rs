//! Decoding what arrives in pieces.

use super::bits::BitReader;
use super::{depth_of, group4, run_grey};
use crate::link::message::Encoding;
use crate::slice::{Bitmap, Depth};

/// Bytes that are not a picture of the agreed size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// A code that does not exist or leads out of the row.
    #[error("a code that does not exist or leads out of its row")]
    BadCode,
    /// The bytes end before the picture does.
    #[error("the bytes end before the last row")]
    TooFewRows,
    /// Bytes are left after the last row.
    #[error("there are bytes after the last row")]
    TooManyRows,
    /// Padding bits that are not 0.
    #[error("padding bits are not 0")]
    BadPadding,
}

/// Turns the bytes of one layer, given in pieces, into a picture. It allocates the picture once, and no more.
#[derive(Debug)]
pub struct Decoder {
    picture: Bitmap,
    rows_done: usize,
    rows: Rows,
    bits: BitReader,
    failed: Option<DecodeError>,
}

#[derive(Debug)]
enum Rows {
    /// Bytes of the picture filled so far.
    Raw(usize),
    Group4(group4::RowDecoder),
    RunGrey(run_grey::RowDecoder),
}

impl Decoder {
    /// A decoder for one picture. The size is the device's own, never taken from the line.
    pub fn new(encoding: Encoding, width_px: u32, height_px: u32) -> Self {
        let rows = match encoding {
            Encoding::RawBit | Encoding::RawGrey => Rows::Raw(0),
            Encoding::Group4 => Rows::Group4(group4::RowDecoder::new(width_px)),
            Encoding::RunGrey => Rows::RunGrey(run_grey::RowDecoder::new()),
        };
        let picture = Bitmap::new(width_px, height_px, depth_of(encoding));
        Self { picture, rows_done: 0, rows, bits: BitReader::default(), failed: None }
    }

    /// Takes the next bytes.
    ///
    /// # Errors
    /// [`DecodeError`]; the same again at every later call.
    pub fn push(&mut self, mut bytes: &[u8]) -> Result<(), DecodeError> {
        self.guarded(|decoder| {
            if let Rows::Raw(filled) = &mut decoder.rows {
                let room = decoder.picture.data_mut().get_mut(*filled..*filled + bytes.len());
                room.ok_or(DecodeError::TooManyRows)?.copy_from_slice(bytes);
                *filled += bytes.len();
                return Ok(());
            }
            while !bytes.is_empty() {
                decoder.bits.fill(&mut bytes);
                decoder.decode()?;
                if decoder.is_full() && decoder.bits.remaining() > u64::BITS - 8 {
                    return Err(DecodeError::TooManyRows);
                }
            }
            Ok(())
        })
    }

    /// No more bytes will come: the picture and the CRC-32 of its rows.
    ///
    /// # Errors
    /// [`DecodeError`].
    pub fn finish(mut self) -> Result<(Bitmap, u32), DecodeError> {
        self.guarded(|decoder| {
            decoder.bits.end();
            decoder.decode()?;
            decoder.check_end()
        })?;
        let crc32 = super::picture_crc32(&self.picture);
        Ok((self.picture, crc32))
    }

    fn guarded(&mut self, work: impl FnOnce(&mut Self) -> Result<(), DecodeError>) -> Result<(), DecodeError> {
        if let Some(error) = self.failed {
            return Err(error);
        }
        let result = work(self);
        self.failed = result.err();
        result
    }

    fn is_full(&self) -> bool {
        self.rows_done == self.picture.height_px() as usize
    }

    /// Takes codes as long as whole ones are there.
    fn decode(&mut self) -> Result<(), DecodeError> {
        let stride = self.picture.stride_bytes();
        while self.bits.is_ready() && !self.is_full() {
            let (above, row) = self.picture.data_mut().split_at_mut(self.rows_done * stride);
            let row = &mut row[..stride];
            let complete = match &mut self.rows {
                Rows::Raw(_) => return Ok(()),
                Rows::Group4(rows) => rows.step(&mut self.bits, row)?,
                Rows::RunGrey(rows) => {
                    let above = &above[above.len() - stride.min(above.len())..];
                    rows.step(&mut self.bits, above, row)?
                }
            };
            if self.bits.is_overdrawn() {
                return Err(DecodeError::TooFewRows);
            }
            self.rows_done += usize::from(complete);
        }
        Ok(())
    }

    fn check_end(&mut self) -> Result<(), DecodeError> {
        if let Rows::Raw(filled) = self.rows {
            return if filled < self.picture.data().len() {
                Err(DecodeError::TooFewRows)
            } else {
                self.check_padding()
            };
        }
        if !self.is_full() {
            return Err(DecodeError::TooFewRows);
        }
        if let Rows::Group4(_) = self.rows {
            group4::take_end(&mut self.bits)?;
        }
        match self.bits.remaining() {
            8.. => Err(DecodeError::TooManyRows),
            left if left > 0 && self.bits.peek(left) != 0 => Err(DecodeError::BadPadding),
            _ => Ok(()),
        }
    }

    /// The padding of raw 1-bit rows is 0, or the CRC would depend on it.
    fn check_padding(&self) -> Result<(), DecodeError> {
        let used = self.picture.width_px() % 8;
        if self.picture.depth() == Depth::Grey || used == 0 {
            return Ok(());
        }
        let mut rows = self.picture.data().chunks_exact(self.picture.stride_bytes());
        let clean = rows.all(|row| row.last().is_none_or(|last| last & (0xff >> used) == 0));
        if clean { Ok(()) } else { Err(DecodeError::BadPadding) }
    }
}
