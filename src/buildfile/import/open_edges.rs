//! Edges of triangles whose other side has not come yet: what is left of a closed surface at its end is nothing. `solid_check` uses it.

use std::collections::HashMap;

/// Most open edges that are held, some 20 MiB. Programs write neighbouring triangles near each other, so that few edges are open at a time;
/// of a file in random order, half of all edges may be.
const MAX_OPEN: usize = 1 << 18;

/// An edge from one corner to another, in fractions of a quantum.
pub(super) type Edge = [[i64; 3]; 2];

/// Tells whether a surface is closed: whether each edge has as many triangles on one side as on the other.
#[derive(Default)]
pub(super) struct OpenEdges {
    /// How much more often each open edge came from its lower corner, which is first, than from the other.
    open: HashMap<Edge, i32>,
    /// Too many were open at a time, and are not held any more.
    overflowed: bool,
    /// Sum of a hash of each edge, negative in the other direction. Of an open surface it is 0 with a chance of 2⁻⁶⁴.
    sum: u64,
}

/// What is known of a surface that is not closed.
#[derive(Debug, PartialEq)]
pub(super) enum Open {
    /// The number of open edges, and one of them.
    Edges(usize, Edge),
    /// Too many were open at a time to tell.
    Unknown,
}

impl OpenEdges {
    /// Adds the edges of a triangle.
    pub(super) fn add(&mut self, [a, b, c]: [[i64; 3]; 3]) {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            let (edge, way) = match from.cmp(&to) {
                std::cmp::Ordering::Less => ([from, to], 1),
                // An edge of no length borders on nothing.
                std::cmp::Ordering::Equal => continue,
                std::cmp::Ordering::Greater => ([to, from], -1),
            };
            let hash = edge.as_flattened().iter().fold(0, |state, at| mix(state ^ *at as u64));
            self.sum = if way > 0 { self.sum.wrapping_add(hash) } else { self.sum.wrapping_sub(hash) };
            self.hold(edge, way);
        }
    }

    fn hold(&mut self, edge: Edge, way: i32) {
        if self.overflowed {
            return;
        }
        let count = self.open.entry(edge).or_insert(0);
        *count += way;
        if *count == 0 {
            self.open.remove(&edge);
        } else if self.open.len() > MAX_OPEN {
            (self.open, self.overflowed) = (HashMap::new(), true);
        }
    }

    /// The edges along which a triangle is missing, in order, each as often as one is; `None` if they are more than [`MAX_OPEN`] or not known.
    pub(super) fn missing(&self) -> Option<Vec<Edge>> {
        if self.overflowed && self.sum != 0 {
            return None;
        }
        let count: u64 = self.open.values().map(|count| u64::from(count.unsigned_abs())).sum();
        if count > MAX_OPEN as u64 {
            return None;
        }
        let directed = self.open.iter().flat_map(|([low, high], count)| {
            let edge = if *count > 0 { [*high, *low] } else { [*low, *high] };
            std::iter::repeat_n(edge, count.unsigned_abs() as usize)
        });
        let mut edges: Vec<_> = directed.collect();
        edges.sort_unstable();
        Some(edges)
    }

    /// Begins anew, and says what was open; `None` if nothing was.
    pub(super) fn finish(&mut self) -> Option<Open> {
        let Self { open, overflowed, sum } = std::mem::take(self);
        if overflowed {
            return (sum != 0).then_some(Open::Unknown);
        }
        // The lowest, so that the same file always gives the same message.
        let lowest = open.keys().min_by_key(|edge| edge.map(|[x, y, z]| [z, y, x]))?;
        Some(Open::Edges(open.len(), *lowest))
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014).
fn mix(value: u64) -> u64 {
    let value = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let value = (value ^ value >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ value >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ value >> 31
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles of a closed strip around a cylinder with lids, `count` around.
    fn drum(count: i64) -> Vec<[[i64; 3]; 3]> {
        let low = |number: i64| [number % count, (number % count).pow(2) % 1000, 0];
        let high = |number: i64| [number % count, (number % count).pow(2) % 1000, 1];
        let around = (0..count).flat_map(move |at| {
            let [a, b, c, d] = [low(at), low(at + 1), high(at + 1), high(at)];
            [[a, b, c], [a, c, d], [b, a, [0, 0, -1]], [d, c, [0, 0, 2]]]
        });
        around.collect()
    }

    #[test]
    fn what_is_open_is_named_also_if_there_is_too_much_to_hold() {
        for (count, fits) in [(1000, true), (200_000, false)] {
            let triangles = drum(count);
            // All of one kind first, so that many edges are open at a time.
            let order = (0..4).flat_map(|kind| triangles.iter().skip(kind).step_by(4));
            let mut edges = OpenEdges::default();
            order.clone().for_each(|triangle| edges.add(*triangle));
            assert_eq!(edges.finish(), None, "{count} around");
            order.skip(1).for_each(|triangle| edges.add(*triangle));
            let found = edges.finish().expect("one is missing");
            match found {
                Open::Edges(3, [[0, 0, 0], [1, 1, 0]]) => assert!(fits),
                Open::Unknown => assert!(!fits),
                other => panic!("{other:?}"),
            }
        }
    }
}
