//! Decodes a layer whose bytes arrive in pieces. The example of [`encoding`](super) uses it.

use alloc::boxed::Box;
use alloc::vec;
use alloc::vec::Vec;

use super::bits::BitReader;
use super::error::DecodeError;
use super::range::RangeDecoder;
use super::{PictureEncoding, group4, run_grey};

/// Turns the bytes of one layer, given in pieces, into a picture. Its memory besides the picture does not grow with the bytes.
#[derive(Debug)]
pub struct Decoder {
    encoding: PictureEncoding,
    width_px: u32,
    height_px: u32,
    /// The picture's raw rows.
    rows: Vec<u8>,
    rows_done: usize,
    code: Code,
    failed: Option<DecodeError>,
}

/// The decoder of an encoding, with the bytes that were given and not yet taken.
#[derive(Debug)]
enum Code {
    /// Bytes of the picture filled so far.
    Raw(usize),
    Group4(BitReader, group4::RowDecoder),
    RunGrey(RangeDecoder, Box<run_grey::RowDecoder>),
}

impl Code {
    /// Takes as many of `bytes` as there is room for.
    fn fill(&mut self, bytes: &mut &[u8]) {
        match self {
            Self::Raw(_) => {}
            Self::Group4(bits, _) => bits.fill(bytes),
            Self::RunGrey(coder, _) => coder.fill(bytes),
        }
    }

    fn end(&mut self) {
        match self {
            Self::Raw(_) => {}
            Self::Group4(bits, _) => bits.end(),
            Self::RunGrey(coder, _) => coder.end(),
        }
    }

    /// Whether the bytes of a step are available, or no more will come.
    fn is_ready(&mut self) -> bool {
        match self {
            Self::Raw(_) => false,
            Self::Group4(bits, _) => bits.is_ready(),
            Self::RunGrey(coder, _) => coder.is_ready(run_grey::RowDecoder::STEP_BYTES),
        }
    }

    /// Whether there are more bytes than the end of the picture needs.
    fn has_surplus(&self) -> bool {
        match self {
            Self::Raw(_) => false,
            Self::Group4(bits, _) => bits.remaining() > u64::BITS - 8,
            Self::RunGrey(coder, _) => coder.bytes_left() > 0,
        }
    }

    /// Decodes one step of a row. Returns whether the row is complete. `above` is empty for the first row.
    fn step(&mut self, above: &[u8], row: &mut [u8]) -> Result<bool, DecodeError> {
        let (complete, overdrawn) = match self {
            Self::Raw(_) => return Ok(false),
            Self::Group4(bits, rows) => (rows.step(bits, row)?, bits.is_overdrawn()),
            Self::RunGrey(coder, rows) => (rows.step(coder, above, row)?, coder.is_overdrawn()),
        };
        if overdrawn { Err(DecodeError::TooFewRows) } else { Ok(complete) }
    }
}

impl Decoder {
    /// A decoder for one picture. The size is the device's own, never taken from the line.
    pub fn new(encoding: PictureEncoding, width_px: u32, height_px: u32) -> Self {
        let code = match encoding {
            PictureEncoding::RawBit | PictureEncoding::RawGrey => Code::Raw(0),
            PictureEncoding::Group4 => Code::Group4(BitReader::default(), group4::RowDecoder::new(width_px)),
            PictureEncoding::RunGrey => Code::RunGrey(RangeDecoder::new(), Box::default()),
        };
        let rows = vec![0; encoding.row_bytes(width_px) * height_px as usize];
        Self { encoding, width_px, height_px, rows, rows_done: 0, code, failed: None }
    }

    /// Takes the next bytes.
    ///
    /// # Errors
    /// [`DecodeError`]; every later call returns the same error.
    pub fn push(&mut self, mut bytes: &[u8]) -> Result<(), DecodeError> {
        self.guarded(|decoder| {
            if let Code::Raw(filled) = &mut decoder.code {
                let room = decoder.rows.get_mut(*filled..*filled + bytes.len());
                room.ok_or(DecodeError::TooManyRows)?.copy_from_slice(bytes);
                *filled += bytes.len();
                return Ok(());
            }
            while !bytes.is_empty() {
                decoder.code.fill(&mut bytes);
                decoder.decode()?;
                if decoder.is_full() && decoder.code.has_surplus() {
                    return Err(DecodeError::TooManyRows);
                }
            }
            Ok(())
        })
    }

    /// Ends the input. Returns the picture's raw rows and their CRC-32.
    ///
    /// # Errors
    /// [`DecodeError`].
    pub fn finish(mut self) -> Result<(Vec<u8>, u32), DecodeError> {
        self.guarded(|decoder| {
            decoder.code.end();
            decoder.decode()?;
            decoder.check_end()
        })?;
        let crc32 = super::rows_crc32(&self.rows);
        Ok((self.rows, crc32))
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
        self.rows_done == self.height_px as usize
    }

    /// Decodes steps while their bytes are available. Every step advances in its row.
    fn decode(&mut self) -> Result<(), DecodeError> {
        let stride = self.encoding.row_bytes(self.width_px);
        while !self.is_full() && self.code.is_ready() {
            let (above, row) = self.rows.split_at_mut(self.rows_done * stride);
            let above = &above[above.len() - stride.min(above.len())..];
            self.rows_done += usize::from(self.code.step(above, &mut row[..stride])?);
        }
        Ok(())
    }

    fn check_end(&mut self) -> Result<(), DecodeError> {
        if let Code::Raw(filled) = self.code {
            return if filled < self.rows.len() { Err(DecodeError::TooFewRows) } else { self.check_padding() };
        }
        if !self.is_full() {
            return Err(DecodeError::TooFewRows);
        }
        match &mut self.code {
            Code::Raw(_) => Ok(()),
            Code::Group4(bits, _) => group4::take_end(bits),
            Code::RunGrey(coder, _) if coder.bytes_left() > 0 => Err(DecodeError::TooManyRows),
            Code::RunGrey(coder, _) if !coder.is_spent() => Err(DecodeError::BadCode),
            Code::RunGrey(..) => Ok(()),
        }
    }

    /// Checks that the padding of raw 1-bit rows is 0: the CRC covers it.
    fn check_padding(&self) -> Result<(), DecodeError> {
        let used = self.width_px % 8;
        if self.encoding.bits_per_pixel() == 8 || used == 0 {
            return Ok(());
        }
        let mut rows = self.rows.chunks_exact(self.encoding.row_bytes(self.width_px));
        let clean = rows.all(|row| row.last().is_none_or(|last| last & (0xff >> used) == 0));
        if clean { Ok(()) } else { Err(DecodeError::BadPadding) }
    }
}
