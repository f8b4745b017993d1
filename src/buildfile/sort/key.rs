//! A strut as the sort keeps it, all of it a key: 32 bytes, in memory and in runs, whose order as numbers is the order of struts in a file.

use crate::buildfile::model::{Cap, Caps, Strut};
use crate::solid::LARGEST_RADIUS;

// Two radii and two caps share eight bytes.
const _: () = assert!(LARGEST_RADIUS < 1 << 30);

/// One strut: (z, y, x) of node a, then of node b, then both radii and caps, the weightiest first.
///
/// The order is total, so that a build file does not depend on the order of its source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct SortKey {
    /// a.z, a.y, a.x, b.z from the weightiest bits on, each with its sign turned so that it ascends.
    high: u128,
    /// b.y, b.x, then 30 bits each of radius a and b and 2 bits each of cap a and b.
    low: u128,
}

impl SortKey {
    /// Bytes of a record in a run.
    pub(super) const BYTES: usize = 32;

    /// Comes after every strut: no cap has the code 3.
    pub(super) const END: Self = Self { high: u128::MAX, low: u128::MAX };

    /// The record of a strut, whose radii are at most [`LARGEST_RADIUS`].
    pub(super) fn of(strut: &Strut) -> Self {
        debug_assert!(strut.radius_a.max(strut.radius_b) <= LARGEST_RADIUS, "checked before: {strut:?}");
        let Strut { a, b, radius_a, radius_b, caps } = strut;
        let join = |words: [u32; 4]| words.into_iter().fold(0, |joined: u128, word| joined << 32 | u128::from(word));
        let attributes = u64::from(*radius_a) << 34 | u64::from(*radius_b) << 4 | (caps.a as u64) << 2 | caps.b as u64;
        Self {
            high: join([ascending(a[2]), ascending(a[1]), ascending(a[0]), ascending(b[2])]),
            low: join([ascending(b[1]), ascending(b[0]), (attributes >> 32) as u32, attributes as u32]),
        }
    }

    /// The strut of this record.
    pub(super) fn strut(&self) -> Strut {
        let word = |number: u128, place: u32| signed((number >> (32 * place)) as u32);
        let Self { high, low } = *self;
        Strut {
            a: [word(high, 1), word(high, 2), word(high, 3)],
            b: [word(low, 2), word(low, 3), word(high, 0)],
            radius_a: (low >> 34) as u32 & LARGEST_RADIUS,
            radius_b: (low >> 4) as u32 & LARGEST_RADIUS,
            caps: Caps { a: cap(low >> 2 & 3), b: cap(low & 3) },
        }
    }

    /// The record's bytes in a run.
    pub(super) fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..16].copy_from_slice(&self.high.to_le_bytes());
        bytes[16..].copy_from_slice(&self.low.to_le_bytes());
        bytes
    }

    /// The record of these bytes of a run.
    pub(super) fn from_bytes(bytes: &[u8; Self::BYTES]) -> Self {
        let (mut high, mut low) = ([0; 16], [0; 16]);
        high.copy_from_slice(&bytes[..16]);
        low.copy_from_slice(&bytes[16..]);
        Self { high: u128::from_le_bytes(high), low: u128::from_le_bytes(low) }
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
    fn records_return_their_struts_and_ascend_with_them() {
        let ends = [i32::MIN, -1, 0, 1, i32::MAX];
        let mut struts = Vec::new();
        for (n, z) in ends.into_iter().enumerate() {
            for (m, y) in ends.into_iter().enumerate() {
                let caps = Caps { a: cap(n as u128 % 3), b: cap(m as u128 % 3) };
                struts.push(Strut { a: [y, 5, z], b: [z, y, i32::MAX], radius_a: 1, radius_b: LARGEST_RADIUS, caps });
                struts.push(Strut { a: [5, y, z], b: [y, z, 7], radius_a: LARGEST_RADIUS, radius_b: 1, caps });
            }
        }
        let key = |strut: &Strut| {
            let Strut { a, b, radius_a, radius_b, caps } = *strut;
            ([a[2], a[1], a[0], b[2], b[1], b[0]], [radius_a, radius_b], [caps.a as u8, caps.b as u8])
        };
        for one in &struts {
            let record = SortKey::of(one);
            assert_eq!(record.strut(), *one);
            assert_eq!(SortKey::from_bytes(&record.to_bytes()), record);
            assert!(record < SortKey::END);
            for other in &struts {
                assert_eq!(record.cmp(&SortKey::of(other)), key(one).cmp(&key(other)));
            }
        }
    }
}
