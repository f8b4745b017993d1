//! A mesh as a text file, for whole prints.

use std::fmt::Write as _;

/// An STL text of a ball with a cavity, millimetres.
pub(crate) fn hollow_ball(centre: [f64; 3], outer_mm: f64, inner_mm: f64) -> String {
    let mut text = "solid hollow ball\n".to_owned();
    sphere(&mut text, centre, outer_mm, false);
    sphere(&mut text, centre, inner_mm, true);
    text + "endsolid\n"
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
