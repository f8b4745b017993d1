//! Thin, near, coincident and nested surfaces with relief: what must neither vanish nor merge.

use std::time::Duration;

use glam::DVec3;
use layerd::layer::Depth;
use layerd::slice::{BodySource, Inspection};

use crate::objects::{Corner, Object, ball, cuboid};
use crate::{LAYER_UM, PIXEL_UM, PLAIN, Part, Recipe, lit, map, pixels, point_mm};

/// All triangles of both.
fn both(mut one: Object, other: &Object) -> Object {
    one.triangles.extend_from_slice(&other.triangles);
    one
}

fn moved(object: Object, by: DVec3) -> Object {
    object.mapped(|corner| corner.at + by)
}

#[test]
fn two_curved_balls_a_tenth_of_a_millimetre_apart_stay_apart() {
    let radius = 0.6;
    for along in [DVec3::X, DVec3::Y, DVec3::new(0.6, 0.8, 0.0), DVec3::new(0.6, 0.0, 0.8)] {
        let apart = along * (2.0 * radius + 0.1);
        let balls = both(ball(radius, 16, 32), &moved(ball(radius, 16, 32), apart));
        let part = Part::new(&balls, &Recipe { is_curved: true, ..PLAIN });
        let plan = part.plan(Depth::Bit);
        let farthest = part.farthest_mm(&plan, |at| radius - at.length().min((at - apart).length()));
        assert!(farthest < 0.003, "{farthest} mm along {along}");
    }
}

#[test]
fn a_gap_of_a_pixel_and_a_half_between_displaced_sides_stays_open() {
    let white = map([4, 4], |_| 1.0);
    let (size, height_mm) = ([0.8, 0.7, 0.6], 0.1);
    for axis in [0, 1] {
        let gap_mm = 1.5 * PIXEL_UM[axis] / 1000.0;
        let mut by = DVec3::ZERO;
        by[axis] = size[axis] + 2.0 * height_mm + gap_mm;
        let part =
            Part::new(&both(cuboid(size), &moved(cuboid(size), by)), &Recipe { map: Some(&white), height_mm, ..PLAIN });
        let plan = part.plan(Depth::Bit);
        let mut seen = 0;
        for (number, bitmap) in part.layers(&plan, 2, 0).iter().enumerate() {
            for (x, y) in pixels(&plan) {
                let at = point_mm(&plan, x, y, number)[axis] - size[axis] - height_mm;
                if (0.0..gap_mm).contains(&at) && at > 1e-4 && at < gap_mm - 1e-4 {
                    assert!(!lit(bitmap, x, y), "layer {number}, {x}, {y}: {at} mm in the gap");
                    seen += 1;
                }
            }
        }
        assert!(seen > 100, "the gap has centres of pixels");
    }
}

#[test]
fn a_fin_of_one_pixel_is_in_every_layer() {
    let white = map([4, 4], |_| 1.0);
    // A tenth of its thickness is displacement.
    for (axis, along) in [(0, 1), (1, 0)] {
        let thick_mm = PIXEL_UM[axis] / 1000.0;
        let height_mm = 0.05 * thick_mm;
        let mut size = [1.0, 1.0, 29.9 * LAYER_UM / 1000.0 - 2.0 * height_mm];
        size[axis] = 0.9 * thick_mm;
        let part = Part::new(&cuboid(size), &Recipe { map: Some(&white), height_mm, ..PLAIN });
        let plan = part.plan(Depth::Bit);
        let layers = part.layers(&plan, 2, 0);
        assert_eq!(layers.len(), 30);
        for (number, bitmap) in layers.iter().enumerate() {
            let count = pixels(&plan).filter(|(x, y)| lit(bitmap, *x, *y)).count() as f64;
            assert!((count - 1000.0 / PIXEL_UM[along]).abs() <= 1.0, "layer {number}: {count} pixels");
        }
    }
}

#[test]
fn a_sheet_without_thickness_prints_nothing() {
    let corner = |x: f64, y: f64| Corner { at: DVec3::new(x, y, 0.2 + x / 3.0), texture: [x, y], normal: None };
    let [a, b, c] = [corner(1.5, 0.1), corner(2.6, 0.3), corner(1.9, 1.4)];
    let sheet = Object { triangles: vec![[a, b, c], [a, c, b]] };
    let foot = cuboid([1.0, 1.0, 1.2]);
    let black = map([4, 4], |_| 0.0);
    for recipe in [Recipe { map: Some(&black), ..PLAIN }, Recipe { is_curved: true, ..PLAIN }] {
        let alone = Part::new(&foot, &recipe);
        let part = Part::new(&both(foot.clone(), &sheet), &recipe);
        let plan = part.plan(Depth::Bit);
        for (number, bitmap) in part.layers(&plan, 2, 0).iter().enumerate() {
            let is_beside = |x: u32, y: u32| point_mm(&plan, x, y, number).x > 1.2;
            let beside = pixels(&plan).filter(|(x, y)| is_beside(*x, *y) && lit(bitmap, *x, *y)).count();
            assert_eq!(beside, 0, "layer {number}");
        }
        let [one, other] = [&alone, &part].map(|part| part.volume_mm3(&part.plan(Depth::Bit)));
        assert!((one - other).abs() < 0.02 * one, "{one} and {other} mm³");
    }
}

#[test]
fn twenty_at_one_place_lose_no_pixel_and_what_lies_within_changes_nothing() {
    let bumpy = map([64, 32], |[u, v]| 0.5 + 0.5 * (20.0 * u).sin() * (9.0 * v).sin());
    let recipe = Recipe { map: Some(&bumpy), height_mm: 0.1, ..PLAIN };
    let one = ball(0.6, 12, 24);
    let twenty = (1..20).fold(one.clone(), |many, _| both(many, &one));
    let within = both(one.clone(), &ball(0.2, 8, 16));
    let alone = Part::new(&one, &recipe);
    let plan = alone.plan(Depth::Bit);
    let layers = alone.layers(&plan, 2, 0);
    for (name, object) in [("twenty", twenty), ("one within the other", within)] {
        let part = Part::new(&object, &recipe);
        assert_eq!(part.plan(Depth::Bit), plan, "{name}");
        for (number, (alone, found)) in layers.iter().zip(part.layers(&plan, 2, 0)).enumerate() {
            let missing = pixels(&plan).filter(|(x, y)| lit(alone, *x, *y) && !lit(&found, *x, *y)).count();
            let more = pixels(&plan).filter(|(x, y)| !lit(alone, *x, *y) && lit(&found, *x, *y)).count();
            assert_eq!([missing, more], [0, 0], "{name}, layer {number}");
        }
    }
}

#[test]
fn an_inspection_names_thin_walls_and_what_is_enclosed_twice() {
    let white = map([4, 4], |_| 1.0);
    let height_mm = 0.1;
    let block = cuboid([1.0, 1.0, 0.9]);
    let inner = moved(cuboid([0.3, 0.3, 0.3]), DVec3::splat(0.3));
    // Displaced inwards on both sides, it is so thick.
    let fin = |thick_px: f64| {
        let thick_mm = thick_px * PIXEL_UM[1] / 1000.0;
        both(block.clone(), &moved(cuboid([0.9, thick_mm + 2.0 * height_mm, 0.9]), DVec3::new(1.3, 0.3, 0.0)))
    };
    let inspected = |object: &Object, height_mm: f64| {
        let part = Part::new(object, &Recipe { map: Some(&white), height_mm, ..PLAIN });
        let (plan, bodies) = (part.plan(Depth::Bit), || BodySource::of(&part.file));
        let found = Inspection::of(bodies, &plan, 2, Duration::from_secs(600), |_| {}).expect("it can be drawn");
        assert_eq!(found.looked_at, plan.layer_count);
        (plan, found)
    };
    let (plan, nested) = inspected(&both(block.clone(), &inner), height_mm);
    let is_within = |layer: &u32| (0.2..0.7).contains(&(plan.layer_z_um(*layer) / 1000.0));
    let layers: Vec<_> = (0..plan.layer_count).filter(is_within).collect();
    assert_eq!((nested.enclosed_twice, nested.thin), (vec![[layers[0], layers[layers.len() - 1]]], vec![]));
    for (thick_px, is_thin) in [(0.6, true), (1.5, false)] {
        let (_, found) = inspected(&fin(thick_px), -height_mm);
        assert_eq!((found.thin.is_empty(), found.enclosed_twice), (!is_thin, vec![]), "{thick_px} pixels");
    }
}
