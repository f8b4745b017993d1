//! The escape layer of lines with XON/XOFF. Neither byte may occur in the data, because the port removes both.
//!
//! It is below the frames: limits and credit count bytes before escaping, so that they do not depend on the data.
//! [`Line`](super::session::Line) uses it.

use alloc::vec::Vec;

const XON: u8 = 0x11;
const XOFF: u8 = 0x13;
const ESCAPE: u8 = 0x10;
/// After an escape comes the byte with this bit flipped.
const FLIP: u8 = 0x40;

/// `bytes` with 0x10, 0x11 and 0x13 each written as 0x10 and the byte ^ 0x40. Delimiters stay as they are.
pub fn escape(bytes: &[u8]) -> Vec<u8> {
    // One byte in 85 of random data is escaped.
    let mut escaped = Vec::with_capacity(bytes.len() + bytes.len() / 32 + 8);
    for &byte in bytes {
        if matches!(byte, XON | XOFF | ESCAPE) {
            escaped.extend_from_slice(&[ESCAPE, byte ^ FLIP]);
        } else {
            escaped.push(byte);
        }
    }
    escaped
}

/// Undoes [`escape`] in a stream. XON and XOFF in the input are dropped; a delimiter ends an incomplete escape.
#[derive(Debug, Default)]
pub struct Unescaper {
    escaped: bool,
}

impl Unescaper {
    /// Appends the unescaped `bytes` to `out`.
    pub fn push(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        for &byte in bytes {
            match byte {
                XON | XOFF => {}
                ESCAPE => self.escaped = true,
                0 => {
                    self.escaped = false;
                    out.push(0);
                }
                _ => out.push(if core::mem::take(&mut self.escaped) { byte ^ FLIP } else { byte }),
            }
        }
    }
}
