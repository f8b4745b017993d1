//! The codes of run lengths in ITU-T T.6 (its tables 2 and 3, the same as in T.4).
//!
//! A run is written as its multiples of 64, if it has any (make-up codes), and then as the rest, 0 to 63 (a terminating code).
//! Used by [`group4`](super::group4); `tests/encoding.rs` compares each code with another coder.

use super::bits::{BitReader, BitWriter};

/// The longest run of one make-up code; longer runs repeat it.
const MAX_MAKE_UP_PX: u32 = 2560;
/// Number of codes of a colour: 0 to 63, then the multiples of 64 up to [`MAX_MAKE_UP_PX`].
const CODES: usize = 64 + MAX_MAKE_UP_PX as usize / 64;
/// No code is longer.
const MAX_CODE_BITS: u32 = 13;
/// Codes of up to this length are found in one step.
const SHORT_BITS: u32 = 8;
/// Longer codes begin with one of at most this many groups of [`SHORT_BITS`] bits.
const MAX_PREFIXES: usize = 9;
/// Codes that continue one prefix.
const CONTINUED: usize = 1 << (MAX_CODE_BITS - SHORT_BITS);

/// A code and its number of bits.
type Code = (u16, u8);

/// The codes of dark runs, which T.6 calls white.
#[rustfmt::skip]
const DARK: [Code; CODES] = [
    (0b00110101, 8), (0b000111, 6), (0b0111, 4), (0b1000, 4), (0b1011, 4), (0b1100, 4), (0b1110, 4), (0b1111, 4),
    (0b10011, 5), (0b10100, 5), (0b00111, 5), (0b01000, 5), (0b001000, 6), (0b000011, 6), (0b110100, 6),
    (0b110101, 6), (0b101010, 6), (0b101011, 6), (0b0100111, 7), (0b0001100, 7), (0b0001000, 7), (0b0010111, 7),
    (0b0000011, 7), (0b0000100, 7), (0b0101000, 7), (0b0101011, 7), (0b0010011, 7), (0b0100100, 7), (0b0011000, 7),
    (0b00000010, 8), (0b00000011, 8), (0b00011010, 8), (0b00011011, 8), (0b00010010, 8), (0b00010011, 8),
    (0b00010100, 8), (0b00010101, 8), (0b00010110, 8), (0b00010111, 8), (0b00101000, 8), (0b00101001, 8),
    (0b00101010, 8), (0b00101011, 8), (0b00101100, 8), (0b00101101, 8), (0b00000100, 8), (0b00000101, 8),
    (0b00001010, 8), (0b00001011, 8), (0b01010010, 8), (0b01010011, 8), (0b01010100, 8), (0b01010101, 8),
    (0b00100100, 8), (0b00100101, 8), (0b01011000, 8), (0b01011001, 8), (0b01011010, 8), (0b01011011, 8),
    (0b01001010, 8), (0b01001011, 8), (0b00110010, 8), (0b00110011, 8), (0b00110100, 8), (0b11011, 5), (0b10010, 5),
    (0b010111, 6), (0b0110111, 7), (0b00110110, 8), (0b00110111, 8), (0b01100100, 8), (0b01100101, 8),
    (0b01101000, 8), (0b01100111, 8), (0b011001100, 9), (0b011001101, 9), (0b011010010, 9), (0b011010011, 9),
    (0b011010100, 9), (0b011010101, 9), (0b011010110, 9), (0b011010111, 9), (0b011011000, 9), (0b011011001, 9),
    (0b011011010, 9), (0b011011011, 9), (0b010011000, 9), (0b010011001, 9), (0b010011010, 9), (0b011000, 6),
    (0b010011011, 9), (0b00000001000, 11), (0b00000001100, 11), (0b00000001101, 11), (0b000000010010, 12),
    (0b000000010011, 12), (0b000000010100, 12), (0b000000010101, 12), (0b000000010110, 12), (0b000000010111, 12),
    (0b000000011100, 12), (0b000000011101, 12), (0b000000011110, 12), (0b000000011111, 12),
];

/// The codes of lit runs, which T.6 calls black.
#[rustfmt::skip]
const LIT: [Code; CODES] = [
    (0b0000110111, 10), (0b010, 3), (0b11, 2), (0b10, 2), (0b011, 3), (0b0011, 4), (0b0010, 4), (0b00011, 5),
    (0b000101, 6), (0b000100, 6), (0b0000100, 7), (0b0000101, 7), (0b0000111, 7), (0b00000100, 8), (0b00000111, 8),
    (0b000011000, 9), (0b0000010111, 10), (0b0000011000, 10), (0b0000001000, 10), (0b00001100111, 11),
    (0b00001101000, 11), (0b00001101100, 11), (0b00000110111, 11), (0b00000101000, 11), (0b00000010111, 11),
    (0b00000011000, 11), (0b000011001010, 12), (0b000011001011, 12), (0b000011001100, 12), (0b000011001101, 12),
    (0b000001101000, 12), (0b000001101001, 12), (0b000001101010, 12), (0b000001101011, 12), (0b000011010010, 12),
    (0b000011010011, 12), (0b000011010100, 12), (0b000011010101, 12), (0b000011010110, 12), (0b000011010111, 12),
    (0b000001101100, 12), (0b000001101101, 12), (0b000011011010, 12), (0b000011011011, 12), (0b000001010100, 12),
    (0b000001010101, 12), (0b000001010110, 12), (0b000001010111, 12), (0b000001100100, 12), (0b000001100101, 12),
    (0b000001010010, 12), (0b000001010011, 12), (0b000000100100, 12), (0b000000110111, 12), (0b000000111000, 12),
    (0b000000100111, 12), (0b000000101000, 12), (0b000001011000, 12), (0b000001011001, 12), (0b000000101011, 12),
    (0b000000101100, 12), (0b000001011010, 12), (0b000001100110, 12), (0b000001100111, 12), (0b0000001111, 10),
    (0b000011001000, 12), (0b000011001001, 12), (0b000001011011, 12), (0b000000110011, 12), (0b000000110100, 12),
    (0b000000110101, 12), (0b0000001101100, 13), (0b0000001101101, 13), (0b0000001001010, 13),
    (0b0000001001011, 13), (0b0000001001100, 13), (0b0000001001101, 13), (0b0000001110010, 13),
    (0b0000001110011, 13), (0b0000001110100, 13), (0b0000001110101, 13), (0b0000001110110, 13),
    (0b0000001110111, 13), (0b0000001010010, 13), (0b0000001010011, 13), (0b0000001010100, 13),
    (0b0000001010101, 13), (0b0000001011010, 13), (0b0000001011011, 13), (0b0000001100100, 13),
    (0b0000001100101, 13), (0b00000001000, 11), (0b00000001100, 11), (0b00000001101, 11), (0b000000010010, 12),
    (0b000000010011, 12), (0b000000010100, 12), (0b000000010101, 12), (0b000000010110, 12), (0b000000010111, 12),
    (0b000000011100, 12), (0b000000011101, 12), (0b000000011110, 12), (0b000000011111, 12),
];

/// Finds the code at the start of the next bits.
struct Lookup {
    /// By the next [`SHORT_BITS`] bits.
    short: [Found; 1 << SHORT_BITS],
    /// By the number of the prefix, then by the bits after it.
    long: [Found; MAX_PREFIXES * CONTINUED],
}

#[derive(Clone, Copy)]
struct Found {
    /// Length of the run; for a prefix, where its part of `long` begins.
    value: u16,
    /// Bits of the code; 0 if there is none, [`PREFIX`] if it is longer.
    bits: u8,
}

const PREFIX: u8 = u8::MAX;
const NO_CODE: Found = Found { value: 0, bits: 0 };

// Constants, so that they lie in flash memory.
static DARK_LOOKUP: Lookup = Lookup::of(&DARK);
static LIT_LOOKUP: Lookup = Lookup::of(&LIT);

impl Lookup {
    const fn of(codes: &[Code; CODES]) -> Self {
        let mut lookup = Self { short: [NO_CODE; 1 << SHORT_BITS], long: [NO_CODE; MAX_PREFIXES * CONTINUED] };
        let (mut index, mut long_used) = (0, 0);
        while index < CODES {
            let (code, bits) = codes[index];
            let run = if index < 64 { index } else { (index - 63) * 64 };
            let found = Found { value: run as u16, bits };
            if bits as u32 <= SHORT_BITS {
                let free = SHORT_BITS - bits as u32;
                fill(&mut lookup.short, (code as usize) << free, 1 << free, found);
            } else {
                let free = MAX_CODE_BITS - bits as u32;
                let prefix = (code >> (bits as u32 - SHORT_BITS)) as usize;
                if lookup.short[prefix].bits != PREFIX {
                    lookup.short[prefix] = Found { value: long_used as u16, bits: PREFIX };
                    long_used += CONTINUED;
                }
                let rest = ((code as usize) << free) % CONTINUED;
                fill(&mut lookup.long, lookup.short[prefix].value as usize + rest, 1 << free, found);
            }
            index += 1;
        }
        lookup
    }
}

/// Writes `count` equal entries from `first` on: the bits behind a code may be any.
const fn fill(entries: &mut [Found], first: usize, count: usize, found: Found) {
    let mut index = first;
    while index < first + count {
        // Each entry belongs to one code.
        assert!(entries[index].bits == 0);
        entries[index] = found;
        index += 1;
    }
}

/// Appends the codes of a run.
pub(super) fn put(mut length_px: u32, lit: bool, writer: &mut BitWriter<'_>) {
    let codes = if lit { &LIT } else { &DARK };
    let mut put = |index: u32| {
        let (code, bits) = codes[index as usize];
        writer.put(code.into(), bits.into());
    };
    while length_px >= MAX_MAKE_UP_PX {
        put(63 + MAX_MAKE_UP_PX / 64);
        length_px -= MAX_MAKE_UP_PX;
    }
    if length_px >= 64 {
        put(63 + length_px / 64);
    }
    put(length_px % 64);
}

/// Takes one code. A run of 64 or more is a make-up code, which another code follows. `None` if there is no such code.
pub(super) fn take(lit: bool, bits: &mut BitReader) -> Option<u32> {
    let lookup = if lit { &LIT_LOOKUP } else { &DARK_LOOKUP };
    let next = bits.peek(MAX_CODE_BITS) as usize;
    let mut found = lookup.short[next >> (MAX_CODE_BITS - SHORT_BITS)];
    if found.bits == PREFIX {
        found = lookup.long[usize::from(found.value) + next % CONTINUED];
    }
    if found.bits == 0 {
        return None;
    }
    bits.skip(found.bits.into());
    Some(found.value.into())
}
