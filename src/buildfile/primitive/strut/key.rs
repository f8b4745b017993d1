//! The key of a strut: the whole strut in 32 bytes, whose order as a number is the order of struts in a file.
//! `sort` compares them.

use crate::buildfile::materials::Shares;
use crate::buildfile::model::{Cap, Caps, Strut};
use crate::buildfile::primitive::Key;
use crate::solid::MAX_RADIUS;

// Two radii and two caps share eight bytes.
const _: () = assert!(MAX_RADIUS < 1 << 30);

/// One strut that is whole of its material: (z, y, x) of node a, then of node b, then radii and caps, from the most significant bits down.
///
/// The order is total, so that a build file does not depend on the order of its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::buildfile) struct StrutKey {
    /// a.z, a.y, a.x and b.z from the most significant bits down. The sign bit of each is inverted, so that unsigned order is
    /// signed order.
    high: u128,
    /// b.y, b.x, then 30 bits for each radius and 2 bits for each cap.
    low: u128,
}

impl StrutKey {
    /// The key of a strut whose radii are at most [`MAX_RADIUS`].
    pub(super) fn of(strut: &Strut) -> Self {
        debug_assert!(strut.radius_a.max(strut.radius_b) <= MAX_RADIUS, "checked before: {strut:?}");
        let Strut { a, b, radius_a, radius_b, caps, .. } = strut;
        let join = |words: [u32; 4]| words.into_iter().fold(0, |joined: u128, word| joined << 32 | u128::from(word));
        let attributes = u64::from(*radius_a) << 34 | u64::from(*radius_b) << 4 | (caps.a as u64) << 2 | caps.b as u64;
        Self {
            high: join([ascending(a[2]), ascending(a[1]), ascending(a[0]), ascending(b[2])]),
            low: join([ascending(b[1]), ascending(b[0]), (attributes >> 32) as u32, attributes as u32]),
        }
    }

    /// The strut of this key.
    pub(super) fn strut(&self) -> Strut {
        let word = |number: u128, place: u32| signed((number >> (32 * place)) as u32);
        let Self { high, low } = *self;
        Strut {
            a: [word(high, 1), word(high, 2), word(high, 3)],
            b: [word(low, 2), word(low, 3), word(high, 0)],
            radius_a: (low >> 34) as u32 & MAX_RADIUS,
            radius_b: (low >> 4) as u32 & MAX_RADIUS,
            caps: Caps { a: cap(low >> 2 & 3), b: cap(low & 3) },
            shares: Shares::default(),
        }
    }
}

impl Key for StrutKey {
    const BYTES: usize = 32;

    /// No cap has the code 3.
    const END: Self = Self { high: u128::MAX, low: u128::MAX };

    fn append_to(self, bytes: &mut Vec<u8>) {
        let mut record = [0; Self::BYTES];
        record[..16].copy_from_slice(&self.high.to_le_bytes());
        record[16..].copy_from_slice(&self.low.to_le_bytes());
        bytes.extend_from_slice(&record);
    }

    fn from_bytes(bytes: &[u8]) -> Self {
        let (mut high, mut low) = ([0; 16], [0; 16]);
        high.copy_from_slice(&bytes[..16]);
        low.copy_from_slice(&bytes[16..]);
        Self { high: u128::from_le_bytes(high), low: u128::from_le_bytes(low) }
    }
}

/// The key of a strut of which a part may be of another material.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::buildfile) struct SharedKey {
    /// The strut's [`StrutKey`] in halves, because numbers of 128 bits would leave gaps.
    strut: [u64; 4],
    shares: [u16; 2],
}

impl SharedKey {
    pub(super) fn of(strut: &Strut) -> Self {
        let StrutKey { high, low } = StrutKey::of(strut);
        let halves = [high >> 64, high, low >> 64, low].map(|half| half as u64);
        Self { strut: halves, shares: [strut.shares.a, strut.shares.b] }
    }

    pub(super) fn strut(&self) -> Strut {
        let [a, b, c, d] = self.strut.map(u128::from);
        let whole = StrutKey { high: a << 64 | b, low: c << 64 | d }.strut();
        Strut { shares: Shares { a: self.shares[0], b: self.shares[1] }, ..whole }
    }
}

impl Key for SharedKey {
    const BYTES: usize = 36;

    const END: Self = Self { strut: [u64::MAX; 4], shares: [u16::MAX; 2] };

    fn append_to(self, bytes: &mut Vec<u8>) {
        self.strut.iter().for_each(|half| bytes.extend_from_slice(&half.to_le_bytes()));
        self.shares.iter().for_each(|share| bytes.extend_from_slice(&share.to_le_bytes()));
    }

    fn from_bytes(bytes: &[u8]) -> Self {
        let half = |at: usize| {
            let mut half = [0; 8];
            half.copy_from_slice(&bytes[8 * at..8 * at + 8]);
            u64::from_le_bytes(half)
        };
        let share = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        Self { strut: [half(0), half(1), half(2), half(3)], shares: [share(32), share(34)] }
    }
}

fn ascending(value: i32) -> u32 {
    value as u32 ^ 1 << 31
}

fn signed(value: u32) -> i32 {
    (value ^ 1 << 31) as i32
}

fn cap(code: u128) -> Cap {
    match code {
        0 => Cap::Sphere,
        1 => Cap::Hemisphere,
        _ => Cap::Butt,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_return_their_struts_and_ascend_with_them() {
        let ends = [i32::MIN, -1, 0, 1, i32::MAX];
        let mut struts = Vec::new();
        for (n, z) in ends.into_iter().enumerate() {
            for (m, y) in ends.into_iter().enumerate() {
                let caps = Caps { a: cap(n as u128 % 3), b: cap(m as u128 % 3) };
                let shares = Shares::default();
                struts.push(Strut {
                    a: [y, 5, z],
                    b: [z, y, i32::MAX],
                    radius_a: 1,
                    radius_b: MAX_RADIUS,
                    caps,
                    shares,
                });
                struts.push(Strut { a: [5, y, z], b: [y, z, 7], radius_a: MAX_RADIUS, radius_b: 1, caps, shares });
            }
        }
        let key = |strut: &Strut| {
            let Strut { a, b, radius_a, radius_b, caps, .. } = *strut;
            ([a[2], a[1], a[0], b[2], b[1], b[0]], [radius_a, radius_b], [caps.a as u8, caps.b as u8])
        };
        for one in &struts {
            let record = StrutKey::of(one);
            assert_eq!(record.strut(), *one);
            let mut bytes = Vec::new();
            record.append_to(&mut bytes);
            assert_eq!((bytes.len(), StrutKey::from_bytes(&bytes)), (StrutKey::BYTES, record));
            assert!(record < StrutKey::END);
            let shared = Strut { shares: Shares { a: 7, b: one.radius_a as u16 }, ..*one };
            let record = SharedKey::of(&shared);
            assert_eq!(record.strut(), shared);
            let mut bytes = Vec::new();
            record.append_to(&mut bytes);
            assert_eq!((bytes.len(), SharedKey::from_bytes(&bytes)), (SharedKey::BYTES, record));
            assert!(record < SharedKey::END);
            for other in &struts {
                assert_eq!(StrutKey::of(one).cmp(&StrutKey::of(other)), key(one).cmp(&key(other)));
                assert_eq!(SharedKey::of(one).cmp(&SharedKey::of(other)), key(one).cmp(&key(other)));
            }
        }
    }
}
