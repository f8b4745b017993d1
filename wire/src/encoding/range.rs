//! An adaptive binary range coder: bits that are nearly certain cost almost nothing.
//!
//! The coder keeps an interval of 32 bits and gives each bit a share in proportion to its probability (Martin 1979; carries and
//! bytewise renormalisation as in Schindler 1998). The last four bytes are the lower end of the interval. A decoder of intact
//! bytes ends with exactly 0, so that missing, surplus or damaged bytes are noticed without an end mark.
//! [`run_grey`](super::run_grey) and [`vectors`](super::vectors) use it.

use alloc::vec::Vec;

/// Below this the interval is widened by a byte. 8 bits are left beside a probability of 16 bits.
const NARROW: u32 = 1 << 24;

/// Probability that the next bit of its kind is 0, in 65536ths; adapts to each bit.
///
/// It stays within 31 to 65505, so no bit is impossible and none costs more than 11.1 bits. Any sequence costs at most 1.03 bits
/// per bit on average.
#[derive(Clone, Copy, Debug)]
pub(super) struct Probability(u16);

impl Probability {
    pub(super) const EVEN: Self = Self(1 << 15);
    /// Each bit moves the probability by a 32nd of the way: fast enough for one layer, steady enough for rare bits.
    const LEARNING_SHIFT: u32 = 5;

    /// The part of an interval that stands for 0. It is neither empty nor the whole interval.
    fn share(self, range: u32) -> u32 {
        (range >> 16) * u32::from(self.0)
    }

    fn learn(&mut self, bit: bool) {
        // Computes both and selects one: the processor cannot predict the bit, and a mispredicted branch costs more.
        let less = self.0 - (self.0 >> Self::LEARNING_SHIFT);
        let more = self.0 + (((1 << 16) - u32::from(self.0)) >> Self::LEARNING_SHIFT) as u16;
        self.0 = if bit { less } else { more };
    }
}

/// Appends bits to bytes.
#[derive(Debug)]
pub(super) struct RangeEncoder<'a> {
    bytes: &'a mut Vec<u8>,
    low: u32,
    range: u32,
}

impl<'a> RangeEncoder<'a> {
    pub(super) fn new(bytes: &'a mut Vec<u8>) -> Self {
        Self { bytes, low: 0, range: u32::MAX }
    }

    /// Number of bytes so far.
    pub(super) fn written_bytes(&self) -> usize {
        self.bytes.len()
    }

    /// Writes a bit with the given probability, which adapts.
    pub(super) fn put(&mut self, bit: bool, probability: &mut Probability) {
        let share = probability.share(self.range);
        probability.learn(bit);
        self.raise(if bit { share } else { 0 });
        self.range = if bit { self.range - share } else { share };
        self.widen();
    }

    /// Writes a number of `bits` bits, at most 16, all values equally likely.
    pub(super) fn put_even(&mut self, value: u32, bits: u32) {
        debug_assert!(bits <= 16 && value >> bits == 0);
        self.range >>= bits;
        self.raise(self.range * value);
        self.widen();
    }

    fn raise(&mut self, by: u32) {
        let (low, carry) = self.low.overflowing_add(by);
        self.low = low;
        if carry {
            // The written bytes and `low` are one number below 1, so an earlier byte takes the carry.
            for byte in self.bytes.iter_mut().rev() {
                *byte = byte.wrapping_add(1);
                if *byte != 0 {
                    break;
                }
            }
        }
    }

    fn widen(&mut self) {
        while self.range < NARROW {
            self.bytes.push((self.low >> 24) as u8);
            self.low <<= 8;
            self.range <<= 8;
        }
    }

    /// Writes the lower end.
    pub(super) fn finish(self) {
        self.bytes.extend_from_slice(&self.low.to_be_bytes());
    }
}

/// Takes bits from bytes that arrive in pieces. After [`end`](Self::end), a decoder without bytes takes zeros and notes that it is
/// overdrawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct RangeDecoder {
    /// The next bytes, in the highest places; 0 below.
    window: u128,
    bytes_left: u32,
    range: u32,
    /// The encoded number less the lower end of the interval. It is below `range` unless the bytes are damaged.
    code: u32,
    started: bool,
    ended: bool,
    overdrawn: bool,
}

impl RangeDecoder {
    const WINDOW_BYTES: u32 = u128::BITS / 8;

    pub(super) fn new() -> Self {
        let (window, range) = (0, u32::MAX);
        Self { window, bytes_left: 0, range, code: 0, started: false, ended: false, overdrawn: false }
    }

    /// Takes as many of `bytes` as there is room for; the rest remains.
    pub(super) fn fill(&mut self, bytes: &mut &[u8]) {
        while self.bytes_left < Self::WINDOW_BYTES
            && let Some((&byte, rest)) = bytes.split_first()
        {
            self.window |= u128::from(byte) << (u128::BITS - 8 - 8 * self.bytes_left);
            self.bytes_left += 1;
            *bytes = rest;
        }
    }

    /// No more bytes will come.
    pub(super) fn end(&mut self) {
        self.ended = true;
    }

    /// Whether `bytes` bytes, at most 16, are available. Reads the start of the code when they are.
    pub(super) fn is_ready(&mut self, bytes: u32) -> bool {
        let ready = self.bytes_left >= bytes || self.ended;
        if ready && !self.started {
            self.started = true;
            (0..4).for_each(|_| self.take_byte());
        }
        ready
    }

    /// Whether more was taken than given.
    pub(super) fn is_overdrawn(&self) -> bool {
        self.overdrawn
    }

    /// Bytes given and not taken.
    pub(super) fn bytes_left(&self) -> u32 {
        self.bytes_left
    }

    /// Whether nothing is left, as after the last bit of intact bytes.
    pub(super) fn is_spent(&self) -> bool {
        self.code == 0 && self.bytes_left == 0
    }

    pub(super) fn take(&mut self, probability: &mut Probability) -> bool {
        let share = probability.share(self.range);
        let bit = self.code >= share;
        probability.learn(bit);
        self.code -= if bit { share } else { 0 };
        self.range = if bit { self.range - share } else { share };
        self.widen();
        bit
    }

    /// Reads a number of `bits` bits, at most 16, all values equally likely.
    pub(super) fn take_even(&mut self, bits: u32) -> u32 {
        self.range >>= bits;
        // Long division: small processors have no divide instruction.
        let mut value = 0;
        for place in (0..bits).rev() {
            let share = self.range << place;
            let bit = self.code >= share;
            self.code -= if bit { share } else { 0 };
            value |= u32::from(bit) << place;
        }
        self.widen();
        value
    }

    fn widen(&mut self) {
        while self.range < NARROW {
            self.range <<= 8;
            self.take_byte();
        }
    }

    fn take_byte(&mut self) {
        self.code = self.code << 8 | (self.window >> (u128::BITS - 8)) as u32;
        self.window <<= 8;
        self.overdrawn |= self.bytes_left == 0;
        self.bytes_left = self.bytes_left.saturating_sub(1);
    }
}

#[cfg(test)]
mod tests {
    use alloc::vec;

    use super::Probability;

    /// Finds the most expensive sequence of bits by dynamic programming from its end.
    #[test]
    fn no_bits_cost_more_than_1_03_each_on_average() {
        const BITS: usize = 100;
        let reached = 31..=65505_u16;
        let mut dearest = vec![0.0_f64; 1 << 16];
        for _ in 0..BITS {
            let mut longer = vec![0.0; 1 << 16];
            for start in reached.clone() {
                let zero_share = f64::from(start) / 65536.0;
                let after = |bit: bool, share: f64| {
                    let mut probability = Probability(start);
                    probability.learn(bit);
                    assert!(reached.contains(&probability.0), "{start} leads to {}", probability.0);
                    dearest[usize::from(probability.0)] - share.log2()
                };
                longer[usize::from(start)] = after(false, zero_share).max(after(true, 1.0 - zero_share));
            }
            dearest = longer;
        }
        let mean = dearest[usize::from(Probability::EVEN.0)] / BITS as f64;
        // 1.0235; the coder's rounding of an interval to 256ths at worst adds less than 0.006.
        assert!((1.0..=1.024).contains(&mean), "{mean} bits a bit");
    }
}
