//! Clouds of points with normals (PLY).

use std::fmt::Write as _;
use std::sync::Arc;

use glam::DVec3;
use layerd::buildfile::{BuildFile, PackError, PackReport, pack};
use layerd::layer::Depth;

use crate::Part;
use crate::objects::{ball, direction};
use crate::pack_bench::Bench;

const RADIUS: f64 = 2.0;
const SHELL: f64 = 0.4;

/// Points spread evenly over a sphere (a spiral of Fibonacci), with their normals.
fn cloud(count: u32) -> Vec<[DVec3; 2]> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let point = |number: u32| {
        let z = 1.0 - 2.0 * (f64::from(number) + 0.5) / f64::from(count);
        let (sin, cos) = (golden * f64::from(number)).sin_cos();
        let across = (1.0 - z * z).sqrt();
        let normal = DVec3::new(across * cos, across * sin, z);
        [normal * RADIUS, normal * 3.0]
    };
    (0..count).map(point).collect()
}

fn ply(points: &[[DVec3; 2]], properties: &str) -> String {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n{properties}end_header\n", points.len());
    for [at, normal] in points {
        writeln!(text, "{} {} {} {} {} {}", at.x, at.y, at.z, normal.x, normal.y, normal.z).expect("a string");
    }
    text
}

const WITH_NORMALS: &str =
    "property float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\nproperty float nz\n";

fn packed(bench: &Bench, text: &str) -> Result<PackReport, PackError> {
    let source = bench.file("in.ply", text.as_bytes());
    pack(&[source], &bench.path("out.layerd"), &bench.options, &mut |_| {})
}

#[test]
fn a_cloud_prints_as_a_shell_without_gaps() {
    let mut bench = Bench::new();
    bench.options.relief.shell_mm = Some(SHELL);
    let report = packed(&bench, &ply(&cloud(4000), WITH_NORMALS)).unwrap_or_else(|error| panic!("{error}"));
    let file = BuildFile::open(&bench.path("out.layerd")).expect("what pack writes is whole");
    file.verify().expect("it agrees with itself");
    let part = Part { _bench: bench, file: Arc::new(file), report };
    let plan = part.plan(Depth::Bit);
    // Discs are flat: their rims stand off by the square of their radius over twice that of the ball.
    let farthest = part.farthest_mm(&plan, |at| (RADIUS - at.length()).min(at.length() - RADIUS + SHELL));
    let spacing = (4.0 * std::f64::consts::PI / 4000.0).sqrt() * RADIUS;
    assert!(farthest < spacing * spacing / RADIUS, "{farthest} mm; points are {spacing} mm apart");
}

#[test]
fn clouds_that_cannot_be_printed_are_refused() {
    let points = cloud(100);
    let mut bench = Bench::new();
    let error = packed(&bench, &ply(&points, WITH_NORMALS)).expect_err("it is no solid").to_string();
    assert!(error.contains("cloud of points") && error.contains("--shell"), "{error}");
    bench.options.relief.shell_mm = Some(SHELL);
    let bare = WITH_NORMALS.replace("nx", "red").replace("ny", "green").replace("nz", "blue");
    let error = packed(&bench, &ply(&points, &bare)).expect_err("no normals").to_string();
    assert!(error.contains("no normals"), "{error}");
    let mut flat = points.clone();
    flat[7][1] = DVec3::ZERO;
    let error = packed(&bench, &ply(&flat, WITH_NORMALS)).expect_err("one has none").to_string();
    assert!(error.contains("vertex 8") && error.contains("normal"), "{error}");
    bench.options.memory_bytes = 1 << 20;
    let error = packed(&bench, &ply(&cloud(20_000), WITH_NORMALS)).expect_err("it is too large").to_string();
    assert!(error.contains("--memory allows 1.0 MiB"), "{error}");
    bench.options.memory_bytes = 64 << 20;
    let same = vec![[DVec3::ONE, DVec3::Z]; 3000];
    let report = packed(&bench, &ply(&same, WITH_NORMALS)).expect("many points in one place take no longer");
    let bounds = report.header.bounds;
    assert_eq!([0, 1].map(|axis| bounds.max[axis] - bounds.min[axis]), [0, 0], "their discs have no width");
}

#[test]
fn normals_and_texture_coordinates_of_vertices_count() {
    let object = ball(RADIUS, 24, 48);
    let mut text = String::new();
    let corners: Vec<_> = object.triangles.iter().flatten().collect();
    let head = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\n{WITH_NORMALS}property float s\nproperty float t\nelement face {}\n\
         property list uchar int vertex_indices\nend_header\n",
        corners.len(),
        object.triangles.len()
    );
    for corner in &corners {
        let ([u, v], normal) = (corner.texture, direction(corner.texture));
        let DVec3 { x, y, z } = corner.at;
        writeln!(text, "{x} {y} {z} {} {} {} {u} {v}", normal.x, normal.y, normal.z).expect("a string");
    }
    for number in 0..object.triangles.len() {
        writeln!(text, "3 {} {} {}", 3 * number, 3 * number + 1, 3 * number + 2).expect("a string");
    }
    let mut bench = Bench::new();
    let value = |[u, v]: [f64; 2]| (u + v) / 2.0;
    let map = bench.file("map.png", &crate::map([512, 256], value));
    bench.options.relief.map =
        Some(layerd::buildfile::DisplacementOptions { map, tile: layerd::buildfile::Tile::Clamp });
    bench.options.relief.height_mm = Some(0.3);
    bench.options.relief.is_curved = true;
    let report = packed(&bench, &(head + &text)).unwrap_or_else(|error| panic!("{error}"));
    let file = BuildFile::open(&bench.path("out.layerd")).expect("what pack writes is whole");
    let part = Part { _bench: bench, file: Arc::new(file), report };
    let farthest = part.farthest_mm(&part.plan(Depth::Bit), |at| {
        let place = crate::objects::place(at);
        // Where the map begins anew there is a step.
        if (0.01..0.99).contains(&place[0]) && at.truncate().length() > 0.1 {
            RADIUS + 0.3 * value(place) - at.length()
        } else {
            f64::NAN
        }
    });
    assert!(farthest < 0.01, "{farthest} mm");
}
