//! Nodes, and what is measured on their meshes, for tests and benches.

pub(crate) mod measure;

use layerd::solid::soap::{Node, StrutEnd};

/// The golden ratio.
const PHI: f64 = 1.618_033_988_749_895;

/// Struts in these directions, long enough for every film.
pub(crate) fn ends(directions: &[[f64; 3]]) -> Vec<StrutEnd> {
    directions.iter().map(|direction| StrutEnd { direction: *direction, length: 100.0 }).collect()
}

/// A node of radius 1 with the usual λ.
pub(crate) fn node(ends: &[StrutEnd]) -> Node<'_> {
    Node { ends, radius: 1.0, lambda: Node::USUAL_LAMBDA }
}

/// The 6, 12 or 20 regular directions: along the axes, to the edges of a cube (octet) or the corners of a dodecahedron.
pub(crate) fn regular(count: usize) -> Vec<[f64; 3]> {
    match count {
        6 => rotated(&signed([1.0, 0.0, 0.0])),
        12 => rotated(&signed([0.0, 1.0, PHI])),
        20 => [signed([1.0, 1.0, 1.0]), rotated(&signed([0.0, 1.0 / PHI, PHI]))].concat(),
        _ => panic!("no regular node has {count} struts"),
    }
}

/// All combinations of signs.
fn signed(direction: [f64; 3]) -> Vec<[f64; 3]> {
    let mut all = vec![direction];
    for axis in 0..3 {
        let flipped: Vec<_> = all.iter().filter(|of| of[axis] != 0.0).map(|of| flip(*of, axis)).collect();
        all.extend(flipped);
    }
    all
}

fn flip(mut direction: [f64; 3], axis: usize) -> [f64; 3] {
    direction[axis] = -direction[axis];
    direction
}

/// Each direction with its coordinates moved on once and twice.
fn rotated(directions: &[[f64; 3]]) -> Vec<[f64; 3]> {
    directions.iter().flat_map(|[x, y, z]| [[*x, *y, *z], [*z, *x, *y], [*y, *z, *x]]).collect()
}

/// SplitMix64 (Steele, Lea & Flood 2014): the same numbers on every machine.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// From −1 to 1.
    pub(crate) fn signed(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((mixed ^ mixed >> 31) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// A unit vector, all directions alike.
    pub(crate) fn direction(&mut self) -> [f64; 3] {
        loop {
            let point = [self.signed(), self.signed(), self.signed()];
            let length = dot(point, point).sqrt();
            if (0.1..1.0).contains(&length) {
                return point.map(|part| part / length);
            }
        }
    }

    /// Up to `count` directions with at least that angle between them; fewer if no room was found.
    pub(crate) fn directions(&mut self, count: usize, least_degrees: f64) -> Vec<[f64; 3]> {
        let most = least_degrees.to_radians().cos();
        let mut found: Vec<[f64; 3]> = Vec::new();
        for _ in 0..100_000 {
            let direction = self.direction();
            if found.len() < count && found.iter().all(|other| dot(*other, direction) < most) {
                found.push(direction);
            }
        }
        found
    }
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
