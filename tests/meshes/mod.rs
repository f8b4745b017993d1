//! A mesh as a text file, for whole prints.

#![allow(dead_code, reason = "each test program uses a part of it")]

use std::fmt::Write as _;

/// An STL text of a ball with a cavity, millimetres.
pub(crate) fn hollow_ball(centre: [f64; 3], outer_mm: f64, inner_mm: f64) -> String {
    let mut text = "solid hollow ball\n".to_owned();
    sphere(&mut text, centre, outer_mm, false);
    sphere(&mut text, centre, inner_mm, true);
    text + "endsolid\n"
}

/// An OBJ text of a box, millimetres, whose sides have the whole of the map of the material `rough` in `rough.mtl`.
pub(crate) fn rough_box(low: [f64; 3], high: [f64; 3]) -> String {
    let mut text = "mtllib rough.mtl\nusemtl rough\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n".to_owned();
    for number in 0..8 {
        let [x, y, z] = [0, 1, 2].map(|axis| if number >> axis & 1 == 1 { high[axis] } else { low[axis] });
        writeln!(text, "v {x} {y} {z}").expect("a string");
    }
    for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        writeln!(text, "f {}/1 {}/2 {}/3 {}/4", a + 1, b + 1, c + 1, d + 1).expect("a string");
    }
    text
}

/// A PNG of a wavy height map.
pub(crate) fn wavy_map() -> Vec<u8> {
    const SIDE: u32 = 64;
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, SIDE, SIDE);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let wave = |at: u32| (f64::from(at) / f64::from(SIDE) * 3.0 * std::f64::consts::TAU).sin();
    let texels =
        (0..SIDE).flat_map(|row| (0..SIDE).map(move |column| (127.0 + 120.0 * wave(row) * wave(column)) as u8));
    let texels: Vec<u8> = texels.collect();
    encoder.write_header().expect("a head").write_image_data(&texels).expect("texels");
    bytes
}

/// A sphere of rings and columns; `is_cavity` turns it inside out.
fn sphere(text: &mut String, centre: [f64; 3], radius_mm: f64, is_cavity: bool) {
    const RINGS: u32 = 24;
    const COLUMNS: u32 = 48;
    let point = |ring: u32, column: u32| {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(RINGS);
        let azimuth = std::f64::consts::TAU * f64::from(column % COLUMNS) / f64::from(COLUMNS);
        // At the poles all columns meet.
        let across = if ring == 0 || ring == RINGS { 0.0 } else { polar.sin() };
        let along = [across * azimuth.cos(), across * azimuth.sin(), -polar.cos()];
        [0, 1, 2].map(|axis| centre[axis] + radius_mm * along[axis])
    };
    for ring in 0..RINGS {
        for column in 0..COLUMNS {
            let [a, b] = [point(ring, column), point(ring, column + 1)];
            let [c, d] = [point(ring + 1, column + 1), point(ring + 1, column)];
            for mut corners in [[a, b, c], [a, c, d]] {
                if is_cavity {
                    corners.swap(1, 2);
                }
                facet(text, corners);
            }
        }
    }
}

fn facet(text: &mut String, corners: [[f64; 3]; 3]) {
    text.push_str("facet normal 0 0 0\nouter loop\n");
    for [x, y, z] in corners {
        writeln!(text, "vertex {x} {y} {z}").expect("a string");
    }
    text.push_str("endloop\nendfacet\n");
}
