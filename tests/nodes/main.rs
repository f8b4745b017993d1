//! Soap-film nodes: closed surfaces that leave the struts smoothly, against formulas and against figures of Luo & Zou 2025.

mod closed;
mod crossing;
mod degenerate;
mod distance;
mod figures;
mod leaving;
mod limit;
#[path = "../node_shapes/mod.rs"]
mod node_shapes;
#[path = "../properties/mod.rs"]
mod properties;
mod same;

use glam::DVec3;
use layerd::solid::soap::{FilmBuilder, FilmMesh, Level, Outline};
use node_shapes::{Random, ends, node, regular};

/// Level `steps`.
fn level(steps: u8) -> Level {
    Level::new(steps).expect("a level")
}

/// The mesh of struts of radius 1 in these directions.
fn mesh(directions: &[[f64; 3]], steps: u8) -> FilmMesh {
    let mut mesh = FilmMesh::default();
    FilmBuilder::new().mesh(&node(&ends(directions)), level(steps), &mut mesh).expect("a film");
    mesh
}

/// The same before fairing.
fn unfaired(directions: &[[f64; 3]], steps: u8) -> FilmMesh {
    let mut mesh = FilmMesh::default();
    FilmBuilder::new().unfaired_mesh(&node(&ends(directions)), level(steps), &mut mesh).expect("a film");
    mesh
}

fn outline(directions: &[[f64; 3]]) -> Outline {
    FilmBuilder::new().outline(&node(&ends(directions))).expect("a film")
}

/// A direction as the mathematics takes it.
fn unit(direction: [f64; 3]) -> DVec3 {
    DVec3::from(direction).normalize()
}

/// Directions that are special: regular, in a plane, on one line, in a half or a small part of the sphere, on one circle, one and two.
fn special() -> Vec<(&'static str, Vec<[f64; 3]>)> {
    let around = |count: u32, z: f64| -> Vec<[f64; 3]> {
        let angles = (0..count).map(|at| f64::from(at) * std::f64::consts::TAU / f64::from(count));
        angles.map(|angle| [angle.cos(), angle.sin(), z]).collect()
    };
    let with_pole = |mut directions: Vec<[f64; 3]>| {
        directions.push([0.0, 0.0, 1.0]);
        directions
    };
    vec![
        ("6", regular(6)),
        ("octet", octet()),
        ("12", regular(12)),
        ("20", regular(20)),
        ("corners of a cube", cube()),
        ("tetrahedron", vec![[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]),
        ("elbow", vec![[1.0, 0.0, 0.0], [0.2, 1.0, 0.0]]),
        ("sharp elbow", vec![[1.0, 0.0, 0.0], [1.0, 0.2, 0.0]]),
        ("almost straight", vec![[1.0, 0.0, 0.0], [-1.0, 0.03, 0.01]]),
        ("T", vec![[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
        ("star of 3", around(3, 0.0)),
        ("star of 4", around(4, 0.0)),
        ("star of 9", around(9, 0.0)),
        ("almost a plane", around(5, 1e-9)),
        ("half of a star", around(8, 0.0).into_iter().take(5).collect()),
        ("umbrella", around(5, 0.4)),
        ("umbrella with a stick", with_pole(around(6, 0.4))),
        ("narrow bundle", with_pole(around(5, 2.0))),
        ("half of the sphere", with_pole(around(7, 0.0))),
        ("one corner", vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    ]
}

/// To the corners of a cube: four on each circle.
fn cube() -> Vec<[f64; 3]> {
    (0..8).map(|bits| [1, 2, 4].map(|bit| if bits & bit == 0 { -1.0 } else { 1.0 })).collect()
}

/// To the edges of a cube, as in an octet lattice.
fn octet() -> Vec<[f64; 3]> {
    let signs = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
    signs.into_iter().flat_map(|[a, b]| [[0.0, a, b], [a, 0.0, b], [a, b, 0.0]]).collect()
}

/// Seeded random nodes with 2 to 20 struts.
fn random(count: u64, least_degrees: f64) -> impl Iterator<Item = Vec<[f64; 3]>> {
    (0..count).map(move |seed| Random(seed).directions(2 + (seed % 19) as usize, least_degrees))
}
