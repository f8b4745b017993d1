//! Bits in bytes, highest first, as ITU-T T.6 orders them. Used by [`group4`](super::group4).

use alloc::vec::Vec;

/// Appends bits to bytes.
pub(super) struct BitWriter<'a> {
    bytes: &'a mut Vec<u8>,
    /// Bits not yet written, in the lowest `count` places; fewer than 32 between calls.
    pending: u64,
    count: u32,
}

impl<'a> BitWriter<'a> {
    pub(super) fn new(bytes: &'a mut Vec<u8>) -> Self {
        Self { bytes, pending: 0, count: 0 }
    }

    /// Appends the lowest `length` bits of `code`, at most 32; higher bits of `code` must be 0.
    pub(super) fn put(&mut self, code: u32, length: u32) {
        debug_assert!(length <= 32 && u64::from(code) < 1 << length);
        self.pending = self.pending << length | u64::from(code);
        self.count += length;
        if self.count >= 32 {
            self.count -= 32;
            self.bytes.extend_from_slice(&((self.pending >> self.count) as u32).to_be_bytes());
        }
    }

    /// Fills the last byte with zeros.
    pub(super) fn finish(self) {
        let bits = ((self.pending << (32 - self.count)) as u32).to_be_bytes();
        self.bytes.extend_from_slice(&bits[..self.count.div_ceil(8) as usize]);
    }
}

/// Takes bits from bytes that arrive in pieces. After [`end`](Self::end), a reader without bits supplies zeros and notes that it is
/// overdrawn.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BitReader {
    /// The next bits, in the highest `count` places; 0 below.
    window: u64,
    count: u32,
    /// More bits were taken than given.
    overdrawn: bool,
    ended: bool,
}

impl BitReader {
    /// Upper bound of the length of a code, in all encodings here.
    const MAX_CODE_BITS: u32 = 40;

    /// Takes as many of `bytes` as there is room for; the rest remains.
    pub(super) fn fill(&mut self, bytes: &mut &[u8]) {
        while self.count <= 56
            && let Some((&byte, rest)) = bytes.split_first()
        {
            self.window |= u64::from(byte) << (56 - self.count);
            self.count += 8;
            *bytes = rest;
        }
    }

    /// No more bytes will come.
    pub(super) fn end(&mut self) {
        self.ended = true;
    }

    /// Whether a whole code can be taken.
    pub(super) fn is_ready(&self) -> bool {
        self.count >= Self::MAX_CODE_BITS || self.ended
    }

    /// Whether more was taken than given.
    pub(super) fn is_overdrawn(&self) -> bool {
        self.overdrawn
    }

    /// Bits given and not taken.
    pub(super) fn remaining(&self) -> u32 {
        self.count
    }

    /// The next `length` bits, 1 to 32, without taking them.
    pub(super) fn peek(&self, length: u32) -> u32 {
        (self.window >> (64 - length)) as u32
    }

    /// Takes `length` bits, at most 32.
    pub(super) fn skip(&mut self, length: u32) {
        self.overdrawn |= length > self.count;
        self.count = self.count.saturating_sub(length);
        self.window <<= length;
    }

    /// Takes `length` bits, 0 to 32.
    pub(super) fn take(&mut self, length: u32) -> u32 {
        if length == 0 {
            return 0;
        }
        let bits = self.peek(length);
        self.skip(length);
        bits
    }
}
