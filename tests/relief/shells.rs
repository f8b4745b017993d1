//! Shells of surfaces, which may be open.

use std::f64::consts::PI;

use layerd::layer::Depth;

use crate::objects::{Object, ball, cuboid};
use crate::{PLAIN, Part, Recipe, map};

const RADIUS: f64 = 2.0;
const SHELL: f64 = 0.4;

#[test]
fn a_shell_is_as_thick_as_it_says() {
    let recipe = Recipe { shell_mm: Some(SHELL), ..PLAIN };
    let part = Part::new(&ball(RADIUS, 60, 90), &recipe);
    let plan = part.plan(Depth::Bit);
    let farthest = part.farthest_mm(&plan, |at| (RADIUS - at.length()).min(at.length() - RADIUS + SHELL));
    assert!(farthest < 0.006, "{farthest} mm");
}

#[test]
fn an_open_surface_prints_as_a_shell() {
    let mut half = ball(RADIUS, 60, 90);
    half.triangles.retain(|corners| corners.iter().all(|corner| corner.at.z < 1e-9));
    let part = Part::new(&half, &Recipe { shell_mm: Some(SHELL), ..PLAIN });
    let plan = part.plan(Depth::Bit);
    // Its rim lies on the plane through the centre.
    let inside = |at: glam::DVec3| (RADIUS - at.length()).min(at.length() - RADIUS + SHELL).min(-at.z);
    let farthest = part.farthest_mm(&plan, inside);
    assert!(farthest < 0.006, "{farthest} mm");
    let expected = 2.0 / 3.0 * PI * (RADIUS.powi(3) - (RADIUS - SHELL).powi(3));
    let found = part.volume_mm3(&plan);
    assert!((found / expected - 1.0).abs() < 0.01, "{found} mm³ instead of {expected}");
}

#[test]
fn a_shell_that_comes_out_on_the_other_side_is_named() {
    let notes = |object: &Object, shell_mm: f64| {
        Part::new(object, &Recipe { shell_mm: Some(shell_mm), ..PLAIN }).report.notes.join("\n")
    };
    let comes_out = "comes out on the other side";
    let mut half = ball(RADIUS, 30, 45);
    half.triangles.retain(|corners| corners.iter().all(|corner| corner.at.z < 1e-9));
    let mut inside_out = cuboid([1.0; 3]);
    inside_out.triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
    for (object, shell_mm, is_named) in [
        (ball(RADIUS, 30, 45), SHELL, false),
        (half, SHELL, false),
        (cuboid([1.0; 3]), 0.9, false),
        (cuboid([1.0; 3]), 3.0, true),
        (inside_out, 0.1, true),
    ] {
        let notes = notes(&object, shell_mm);
        assert_eq!(notes.contains(comes_out), is_named, "{shell_mm} mm: {notes}");
    }
}

#[test]
fn a_displaced_shell_follows_the_map_on_both_sides() {
    let white = map([4, 4], |_| 1.0);
    let recipe = Recipe { map: Some(&white), height_mm: 0.3, shell_mm: Some(SHELL), ..PLAIN };
    let part = Part::new(&ball(RADIUS, 60, 90), &recipe);
    let plan = part.plan(Depth::Bit);
    let outer = RADIUS + 0.3;
    let farthest = part.farthest_mm(&plan, |at| (outer - at.length()).min(at.length() - outer + SHELL));
    assert!(farthest < 0.006, "{farthest} mm");
}
