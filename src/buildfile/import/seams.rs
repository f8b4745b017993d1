//! Seams: edges of patches that no neighbour continues with the same corners and the same displacement. `relief` uses it.

use std::collections::HashMap;

use crate::buildfile::relief::{Corner, Patch};

/// Memory for each patch, bytes: up to three open edges in a hash table that is at least 7/16 full.
pub(super) const BYTES_PER_PATCH: u64 = 3 * (size_of::<Edge>() as u64 + 4 + 1) * 16 / 7;

/// An edge as its patches see it, its lower corner first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Edge {
    corners: [Corner; 2],
    displacement: u8,
}

/// The edge from a corner to the next, and whether it runs upwards.
fn edge(patch: &Patch, number: usize) -> (Edge, bool) {
    let [from, to] = [patch.corners[number], patch.corners[(number + 1) % 3]];
    let runs_up = from <= to;
    (Edge { corners: if runs_up { [from, to] } else { [to, from] }, displacement: patch.displacement }, runs_up)
}

/// Marks the seams of all patches.
pub(super) fn mark(patches: &mut [Patch]) {
    // How much more often each edge is run along upwards.
    let mut open: HashMap<Edge, i32> = HashMap::new();
    for patch in patches.iter() {
        for number in 0..3 {
            let (edge, runs_up) = edge(patch, number);
            let count = open.entry(edge).or_insert(0);
            *count += if runs_up { 1 } else { -1 };
            if *count == 0 {
                open.remove(&edge);
            }
        }
    }
    for patch in patches {
        patch.seams =
            (0..3).filter(|number| open.contains_key(&edge(patch, *number).0)).map(|number| 1 << number).sum();
    }
}
