//! Counts distinct nodes while struts are written in file order. `lattice` counts with it.

use std::collections::HashSet;
use std::hash::{BuildHasher, Hasher, RandomState};

use crate::buildfile::model::{Strut, node_key};

/// Most upper nodes remembered, about 8 MB. When they are reached, the nodes below the current strut are forgotten. If more than half
/// of them stay, the count is given up, because the set would be full again too soon.
const MAX_WAITING: usize = 1 << 18;

/// The counter. A node is counted when it is first seen, as an upper or a lower end.
#[derive(Debug, Default)]
pub(super) struct NodeCounter {
    /// Upper ends at which no strut has begun yet.
    waiting: HashSet<[i32; 3], Folding>,
    low: Option<[i32; 3]>,
    count: u64,
    unknown: bool,
}

impl NodeCounter {
    /// Counts the nodes of one strut.
    pub(super) fn count(&mut self, strut: &Strut) {
        if self.unknown {
            return;
        }
        if self.low != Some(strut.a) {
            self.low = Some(strut.a);
            self.count += u64::from(!self.waiting.remove(&strut.a));
        }
        if strut.b != strut.a && self.waiting.insert(strut.b) {
            self.count += 1;
        }
        if self.waiting.len() > MAX_WAITING {
            // Nodes below the current strut cannot come again.
            self.waiting.retain(|node| node_key(*node) > node_key(strut.a));
            self.unknown = self.waiting.len() > MAX_WAITING / 2;
            if self.unknown {
                self.waiting = HashSet::default();
            }
        }
    }

    /// Number of distinct nodes; 0 if they could not be counted.
    pub(super) fn total(&self) -> u64 {
        if self.unknown { 0 } else { self.count }
    }
}

/// A hash by multiplying and folding, as in wyhash (Wang Yi 2019); it is many times faster than the standard hash. It starts from a
/// random number, so that no file can be made whose nodes all fall into one bucket.
#[derive(Clone, Debug)]
struct Folding {
    start: u64,
}

impl Default for Folding {
    fn default() -> Self {
        Self { start: RandomState::new().hash_one(0u8) }
    }
}

impl BuildHasher for Folding {
    type Hasher = Folded;

    fn build_hasher(&self) -> Folded {
        Folded { state: self.start }
    }
}

struct Folded {
    state: u64,
}

impl Hasher for Folded {
    fn write(&mut self, bytes: &[u8]) {
        for part in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..part.len()].copy_from_slice(part);
            let product = u128::from(self.state ^ u64::from_le_bytes(word)) * 0x9e37_79b9_7f4a_7c15;
            self.state = (product >> 64) as u64 ^ product as u64;
        }
    }

    fn finish(&self) -> u64 {
        self.state
    }
}
