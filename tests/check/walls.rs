//! Walls of solids that are too thin, surfaces within surfaces, and tops that are dark.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::layerctl;
use crate::{bench, check, json, stderr};

/// Boxes between two corners as OBJ, millimetres. One whose corners are the other way round is turned inside out.
fn boxes(path: &Path, boxes: &[[[f64; 3]; 2]]) {
    let mut text = String::new();
    for [from, to] in boxes {
        for corner in 0..8 {
            let [x, y, z] = [0, 1, 2].map(|axis| if corner >> axis & 1 == 0 { from[axis] } else { to[axis] });
            writeln!(text, "v {x} {y} {z}").expect("a string");
        }
        text += "f -8 -6 -5 -7\nf -4 -3 -1 -2\nf -8 -7 -3 -4\nf -6 -2 -1 -5\nf -8 -4 -2 -6\nf -7 -5 -1 -3\n";
    }
    fs::write(path, text).expect("written");
}

fn packed(dir: &Path, solids: &[[[f64; 3]; 2]]) {
    boxes(&dir.join("part.obj"), solids);
    let packed = layerctl(dir, &["pack", "part.obj", "-o", "part.layerd"]);
    assert!(packed.status.success(), "{}", stderr(&packed));
}

const BLOCK: [[f64; 3]; 2] = [[0.0; 3], [2.0, 2.0, 3.0]];

#[test]
fn thin_walls_are_named_and_the_print_still_fits() {
    let dir = bench("", &[]);
    // Pixels of 50 × 60 µm, and layers of 0.1 mm.
    for (thickness_mm, is_thin) in [(0.03, true), (0.05, false)] {
        packed(dir.path(), &[BLOCK, [[1.0, 1.0, 1.0], [1.0 + thickness_mm, 4.0, 2.0]]]);
        let checked = check(dir.path(), &["--json"]);
        let found = json(&checked);
        assert_eq!((checked.status.code(), &found["fits"]), (Some(0), &Value::from(true)), "{found}");
        assert_eq!(found["inspected_layers"], 30);
        let told = String::from_utf8(check(dir.path(), &[]).stdout).expect("text");
        let words = "walls thinner than a pixel are in layers 10 to 19, for example one of 0.";
        assert_eq!(told.contains(words), is_thin, "{told}");
        let layers = if is_thin { vec![[10, 19]] } else { vec![] };
        assert_eq!(found["thin_wall_layers"], serde_json::json!(layers), "{found}");
    }
}

#[test]
fn surfaces_within_surfaces_are_told_unless_they_are_cavities() {
    let dir = bench("", &[]);
    let inner = [[0.5, 0.5, 0.5], [1.5, 1.5, 2.0]];
    let [low, high] = inner;
    let turned = [[high[0], low[1], low[2]], [low[0], high[1], high[2]]];
    for (solid, is_told) in [(inner, true), (turned, false)] {
        packed(dir.path(), &[BLOCK, solid]);
        let found = json(&check(dir.path(), &["--json"]));
        let layers = if is_told { vec![[5, 19]] } else { vec![] };
        assert_eq!(found["enclosed_twice_layers"], serde_json::json!(layers), "{found}");
        let problems = found["problems"].to_string();
        assert_eq!(problems.contains("for a cavity, turn the inner surface inside out"), is_told, "{problems}");
    }
}

#[test]
fn a_dark_top_is_told_unless_it_is_a_rest_of_a_layer() {
    let dir = bench("", &[]);
    let needle = [[1.0, 1.0, 2.5], [1.01, 1.01, 3.55]];
    for (solids, dark, is_told) in
        [(&[BLOCK][..], 0, false), (&[[[0.0; 3], [2.0, 2.0, 3.03]]], 1, false), (&[BLOCK, needle], 6, true)]
    {
        packed(dir.path(), solids);
        let found = json(&check(dir.path(), &["--json"]));
        assert_eq!(found["dark_top_layers"], dark, "{found}");
        let problems = found["problems"].to_string();
        assert_eq!(
            problems.contains("nothing is lit from layer 30 on: the top of the part is too thin"),
            is_told,
            "{problems}"
        );
    }
}
