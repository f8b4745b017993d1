//! Meshes with formulas. Lengths are micrometres.

#![allow(dead_code, reason = "each test program uses a part of it")]

use glam::{DMat3, DVec3};
use layerd::buildfile::{QUANTUM_FRACTIONS, Triangle};

use crate::box_mesh::{box_triangles, corner};

/// Triangles, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mesh(pub(crate) Vec<[DVec3; 3]>);

impl Mesh {
    pub(crate) fn and(mut self, other: &Self) -> Self {
        self.0.extend_from_slice(&other.0);
        self
    }

    pub(crate) fn reversed(mut self) -> Self {
        self.0.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        self
    }

    pub(crate) fn moved(mut self, turn: DMat3, by: DVec3) -> Self {
        self.0.iter_mut().flatten().for_each(|corner| *corner = turn * *corner + by);
        self
    }

    pub(crate) fn lowest_um(&self) -> f64 {
        self.0
            .iter()
            .flatten()
            .map(|corner| fractions(corner.z) as f64 / QUANTUM_FRACTIONS as f64)
            .fold(f64::MAX, f64::min)
    }

    /// As a build file with a quantum of 1 µm has them.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = Triangle> {
        self.0.iter().map(|corners| Triangle::new(corners.map(|corner| corner.to_array().map(fractions))))
    }
}

fn fractions(um: f64) -> i64 {
    (um * QUANTUM_FRACTIONS as f64).round() as i64
}

/// A box between two corners.
pub(crate) fn cuboid(low: [f64; 3], high: [f64; 3]) -> Mesh {
    let place = |number| DVec3::from_array(corner(number, low, high));
    Mesh(box_triangles().map(|triangle| triangle.map(place)).collect())
}

/// A ball of `20 · 4^levels` triangles, whose corners lie on the sphere.
pub(crate) fn ball(centre: [f64; 3], radius: f64, levels: u32) -> Mesh {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut corners = Vec::new();
    for (a, b) in [(1.0, golden), (1.0, -golden), (-1.0, golden), (-1.0, -golden)] {
        corners.extend([DVec3::new(0.0, a, b), DVec3::new(a, b, 0.0), DVec3::new(b, 0.0, a)]);
    }
    let mut triangles = Vec::new();
    for a in 0..12 {
        for b in 0..12 {
            for c in 0..12 {
                let [a, b, c] = [corners[a], corners[b], corners[c]];
                let near = |a: DVec3, b: DVec3| (a.distance(b) - 2.0).abs() < 1e-9;
                // Each once, beginning with its first corner, and seen from outside.
                let is_first = [b, c].iter().all(|other| a.to_array() < other.to_array());
                if near(a, b) && near(b, c) && near(c, a) && is_first && a.dot(b.cross(c)) > 0.0 {
                    triangles.push([a, b, c].map(DVec3::normalize));
                }
            }
        }
    }
    for _ in 0..levels {
        let quarters = |[a, b, c]: [DVec3; 3]| {
            let [ab, bc, ca] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        triangles = triangles.into_iter().flat_map(quarters).collect();
    }
    let mesh = Mesh(triangles);
    mesh.moved(DMat3::from_diagonal(DVec3::splat(radius)), centre.into())
}

/// An upright cylinder of `sides` sides.
pub(crate) fn cylinder(radius: f64, [low, high]: [f64; 2], sides: u32) -> Mesh {
    let corner = |number: u32, z: f64| {
        let angle = f64::from(number % sides) / f64::from(sides) * std::f64::consts::TAU;
        DVec3::new(radius * angle.cos(), radius * angle.sin(), z)
    };
    let side = |number: u32| {
        let [a, b, c, d] =
            [corner(number, low), corner(number + 1, low), corner(number + 1, high), corner(number, high)];
        [[a, b, c], [a, c, d], [DVec3::Z * low, b, a], [DVec3::Z * high, d, c]]
    };
    Mesh((0..sides).flat_map(side).collect())
}

/// By how much a point lies inside the faceted ball: exact but for points beside an edge or corner outside.
pub(crate) fn inside_convex(mesh: &Mesh, point: [f64; 3]) -> f64 {
    let point = DVec3::from(point);
    let behind = mesh.0.iter().map(|[a, b, c]| (*b - *a).cross(*c - *a).normalize().dot(*a - point));
    behind.fold(f64::MAX, f64::min)
}

/// A turn about all three axes.
pub(crate) fn turn(angles: [f64; 3]) -> DMat3 {
    DMat3::from_rotation_z(angles[2]) * DMat3::from_rotation_y(angles[1]) * DMat3::from_rotation_x(angles[0])
}
