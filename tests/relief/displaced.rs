//! Displacement by a map.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use layerd::buildfile::Tile;
use layerd::layer::Depth;

use crate::objects::{ball, cuboid, place};
use crate::{LAYER_UM, PIXEL_UM, PLAIN, Part, Recipe, lit, map, pixels, point_mm};

const SIZE: [f64; 3] = [2.3, 1.9, 1.4];

/// By how much a point lies inside a box that was displaced evenly: outwards, there is a slab on each of its sides.
fn inside_plus(at: DVec3, height: f64) -> f64 {
    let in_core = at.min(DVec3::from(SIZE) - at);
    if height < 0.0 {
        return in_core.min_element() + height;
    }
    let in_slab = |axis: usize| {
        let across = (0..3).filter(|other| *other != axis).map(|other| in_core[other]).fold(f64::MAX, f64::min);
        across.min(in_core[axis] + height)
    };
    (0..3).map(in_slab).fold(f64::MIN, f64::max)
}

#[test]
fn flat_sides_stay_flat_and_their_triangles_do_not_matter() {
    let white = map([8, 8], |_| 1.0);
    for (height_mm, rotate_deg) in [(0.31, [0.0; 3]), (0.17, [20.0, -35.0, 50.0]), (-0.2, [90.0, 0.0, 13.0])] {
        let recipe = Recipe { map: Some(&white), height_mm, rotate_deg, ..PLAIN };
        let coarse = Part::new(&cuboid(SIZE), &recipe);
        let fine = Part::new(&cuboid(SIZE).divided(4), &recipe);
        let plan = coarse.plan(Depth::Bit);
        assert_eq!(plan, fine.plan(Depth::Bit));
        assert!(coarse.layers(&plan, 1, 0) == fine.layers(&plan, 2, 0), "12 and 3072 triangles are the same surface");
        let back = turned_back(rotate_deg);
        let farthest = coarse.farthest_mm(&plan, |at| inside_plus(back(at), height_mm));
        assert!(farthest < 0.03 * LAYER_UM / 1000.0, "{farthest} mm at {rotate_deg:?}");
    }
}

/// Undoes a rotation about x, then y, then z.
fn turned_back(degrees: [f64; 3]) -> impl Fn(DVec3) -> DVec3 {
    let [x, y, z] = degrees.map(f64::to_radians);
    let turn = glam::DMat3::from_rotation_z(z) * glam::DMat3::from_rotation_y(y) * glam::DMat3::from_rotation_x(x);
    move |at| turn.transpose() * at
}

/// A value that vanishes at the poles.
fn bumps([u, v]: [f64; 2]) -> f64 {
    0.5 + 0.5 * (PI * v).sin().powi(2) * (5.0 * TAU * u).cos() * (3.0 * TAU * v).sin()
}

#[test]
fn a_bumpy_ball_is_where_the_formula_says() {
    let bumpy = map([1024, 512], bumps);
    let radius = 2.0;
    for voxels in [3.0, 10.0, 20.0] {
        let height_mm = voxels * PIXEL_UM[1] / 1000.0;
        let recipe = Recipe { map: Some(&bumpy), height_mm, offset_mm: -height_mm / 2.0, is_curved: true, ..PLAIN };
        let part = Part::new(&ball(radius, 48, 96), &recipe);
        let plan = part.plan(Depth::Bit);
        // Both are measured along the radius: less than along the normal by the cosine of the slope.
        let farthest = part.farthest_mm(&plan, |at| radius + height_mm * (bumps(place(at)) - 0.5) - at.length());
        let in_voxels = farthest * 1000.0 / PIXEL_UM[1];
        assert!(in_voxels < 0.06, "{in_voxels} voxels at a displacement of {voxels}");
    }
}

#[test]
fn a_bump_that_meets_no_edge_of_a_triangle_is_printed() {
    // The triangles of each side meet along a diagonal; the bumps lie beside it.
    let value = |[u, v]: [f64; 2]| {
        let bump = |x: f64, y: f64| (1.0 - ((u - x).hypot(v - y) / 0.05).powi(2)).max(0.0).powi(2);
        bump(0.75, 0.3) + bump(0.25, 0.7)
    };
    let bumps = map([256, 256], value);
    let recipe = Recipe { map: Some(&bumps), height_mm: 0.5, ..PLAIN };
    let part = Part::new(&cuboid([4.0, 4.0, 1.0]), &recipe);
    let plan = part.plan(Depth::Bit);
    let farthest = part.farthest_mm(&plan, |at| {
        // On the upper side, texture coordinates run along the edges.
        let is_above = at.z > 1.02 && (0..2).all(|axis| (0.02..3.98).contains(&at[axis]));
        if is_above { 1.0 + 0.5 * value([at.x / 4.0, at.y / 4.0]) - at.z } else { f64::NAN }
    });
    assert!(farthest < 0.02, "{farthest} mm");
    assert!(part.file.header().bounds.max[2] > 1450, "{:?}", part.file.header().bounds);
}

#[test]
fn a_tessellation_that_is_displaced_itself_comes_nearer_as_it_is_refined() {
    let value =
        |[u, v]: [f64; 2]| 0.5 + 0.3 * (TAU * u).sin() * (2.0 * TAU * v).sin() + 0.2 * (3.0 * TAU * (u + v)).cos();
    let wavy = map([256, 256], value);
    let height_mm = 0.3;
    let base = || cuboid(SIZE);
    let ours = Part::new(&base(), &Recipe { map: Some(&wavy), height_mm, ..PLAIN });
    let plan = ours.plan(Depth::Bit);
    let layers = ours.layers(&plan, 2, 0);
    // The upper side alone is compared: at creases, a tessellation is open.
    let top = |fine: u32| {
        base().divided(fine).mapped(|corner| {
            let lift = if corner.at.z == SIZE[2] { height_mm * value(corner.texture) } else { 0.0 };
            corner.at + DVec3::Z * lift
        })
    };
    let mut last = u64::MAX;
    for fine in [2, 4, 6] {
        let theirs = Part::new(&top(fine), &PLAIN);
        let mut off = 0_u64;
        let their_layers = theirs.layers(&plan, 2, 0);
        for (number, (a, b)) in layers.iter().zip(&their_layers).enumerate() {
            for (x, y) in pixels(&plan) {
                let at = point_mm(&plan, x, y, number);
                let is_above =
                    at.z > SIZE[2] + 0.01 && (0..2).all(|axis| at[axis] > 0.02 && at[axis] < SIZE[axis] - 0.02);
                off += u64::from(is_above && lit(a, x, y) != lit(b, x, y));
            }
        }
        assert!(off < last, "{off} pixels differ with {} triangles, {last} with fewer", 12 * 4_u32.pow(fine));
        last = off;
    }
    assert!(last < 60, "{last} pixels differ from the finest");
}

#[test]
fn neither_threads_nor_the_start_change_a_layer_and_grey_agrees() {
    let noise = map([64, 64], |[u, v]| (1e4 * (12.9898 * u + 78.233 * v).sin()).rem_euclid(1.0));
    let recipe = Recipe { map: Some(&noise), height_mm: 0.4, offset_mm: -0.2, rotate_deg: [10.0, 20.0, 30.0], ..PLAIN };
    let part = Part::new(&cuboid(SIZE), &recipe);
    for depth in [Depth::Bit, Depth::Grey] {
        let plan = part.plan(depth);
        let layers = part.layers(&plan, 1, 0);
        assert!(layers == part.layers(&plan, 3, 0));
        assert!(layers[17..] == part.layers(&plan, 2, 17)[..]);
    }
    let [bits, grey] = [Depth::Bit, Depth::Grey].map(|depth| part.layers(&part.plan(depth), 2, 0));
    let sums = bits.iter().zip(&grey).map(|(bits, grey)| {
        let sum: u64 = grey.data().iter().map(|value| u64::from(*value)).sum();
        [bits.data().iter().map(|byte| u64::from(byte.count_ones())).sum::<u64>(), sum / 255]
    });
    let [bits, grey] = sums.fold([0, 0], |sum, layer| [sum[0] + layer[0], sum[1] + layer[1]]);
    assert!(bits.abs_diff(grey) < bits / 200, "{bits} white pixels, and grey ones that make {grey}");
}

#[test]
fn wild_displacement_leaves_no_streaks() {
    // Noise far higher than a texel, normals that do not match at creases, and values below the surface.
    let noise = map([37, 53], |[u, v]| (1e4 * (12.9898 * u + 78.233 * v).sin()).rem_euclid(1.0));
    for (tile, rotate_deg) in [
        (Tile::Wrap, [0.0; 3]),
        (Tile::Mirror, [45.0, 0.0, 45.0]),
        (Tile::Clamp, [1.0, 2.0, 3.0]),
        (Tile::Nothing, [0.0; 3]),
    ] {
        let mut scaled = cuboid(SIZE).divided(1);
        scaled
            .triangles
            .iter_mut()
            .flatten()
            .for_each(|corner| corner.texture = corner.texture.map(|at| 2.5 * at - 0.7));
        let recipe = Recipe { map: Some(&noise), tile, height_mm: 0.9, offset_mm: -0.5, rotate_deg, ..PLAIN };
        let part = Part::new(&scaled, &recipe);
        let plan = part.plan(Depth::Bit);
        let bounds = part.file.header().bounds;
        let mut lit_count = 0;
        for (number, bitmap) in part.layers(&plan, 2, 0).iter().enumerate() {
            for (x, y) in pixels(&plan).filter(|(x, y)| lit(bitmap, *x, *y)) {
                let at = point_mm(&plan, x, y, number) * 1000.0;
                let is_within = (0..3).all(|axis| {
                    (f64::from(bounds.min[axis]) - 2.0..=f64::from(bounds.max[axis]) + 2.0).contains(&at[axis])
                });
                assert!(is_within, "{at} µm is lit, outside {bounds:?}");
                lit_count += 1;
            }
        }
        assert!(lit_count > 10_000, "{lit_count}");
    }
}

#[test]
fn coarse_pixels_see_the_mean_of_a_fine_map() {
    // Stripes of a texel are finer than a pixel: sampled as they are, they would make a pattern.
    let stripes = map([1024, 4], |[u, _]| f64::from((u * 1024.0) as u32 % 2));
    let recipe = Recipe { map: Some(&stripes), height_mm: 0.8, ..PLAIN };
    let part = Part::new(&cuboid([4.0, 4.0, 1.0]), &recipe);
    let plan = part.plan_of(Depth::Bit, [50.0, 50.0], 50.0);
    let farthest = part.farthest_mm(&plan, |at| {
        // Only the middle of the upper side.
        let is_middle = (0..2).all(|axis| (0.2..3.8).contains(&at[axis]));
        if is_middle && at.z > 1.05 { 1.4 - at.z } else { f64::NAN }
    });
    assert!(farthest < 0.05, "{farthest} mm");
}

#[test]
fn there_is_a_step_where_nothing_lies_beyond_the_map() {
    let black = map([4, 4], |_| 0.0);
    // The map covers the middle half of each side.
    let mut object = cuboid(SIZE);
    object.triangles.iter_mut().flatten().for_each(|corner| corner.texture = corner.texture.map(|at| 2.0 * at - 0.5));
    let recipe = Recipe { map: Some(&black), tile: Tile::Nothing, height_mm: 0.0, offset_mm: 0.3, ..PLAIN };
    let part = Part::new(&object, &recipe);
    let plan = part.plan(Depth::Bit);
    let farthest = part.farthest_mm(&plan, |at| {
        let is_on_map = (0..2).all(|axis| (0.28..0.72).contains(&(at[axis] / SIZE[axis])));
        let is_off_map = (0..2).any(|axis| !(0.22..0.78).contains(&(at[axis] / SIZE[axis])));
        let is_above = (0..2).all(|axis| (0.1..SIZE[axis] - 0.1).contains(&at[axis])) && at.z > SIZE[2];
        match (is_above, is_on_map, is_off_map) {
            (true, true, _) => SIZE[2] + 0.3 - at.z,
            (true, _, true) => SIZE[2] - at.z,
            _ => f64::NAN,
        }
    });
    assert!(farthest < 0.001, "{farthest} mm");
}
