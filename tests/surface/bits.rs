//! Pixels of surfaces.

use glam::{DMat3, DVec3};
use layerd::layer::{Depth, Mirror};
use proptest::prelude::*;

use crate::properties;
use crate::shapes::{Mesh, ball, cuboid, inside_convex, turn};
use crate::{HEIGHT, PIXEL_UM, Part, UPRIGHT, WIDTH, lit};

const CENTRE: DVec3 = DVec3::new(1200.0, 1080.0, 900.0);

proptest! {
    #![proptest_config(properties::cases(12))]

    #[test]
    fn a_turned_box_is_exact(
        angles in prop::array::uniform3(-3.0..3.0), half in prop::array::uniform3(20.0..500.0), x in any::<bool>(), y in any::<bool>(),
    ) {
        let mesh = cuboid(half.map(|um: f64| -um), half).moved(turn(angles), CENTRE);
        let part = Part::new(&mesh, Depth::Bit, Mirror { x, y }, 60.0);
        part.assert_solid(|point| inside_convex(&mesh, point));
    }

    #[test]
    fn neither_threads_nor_the_start_change_a_layer(
        angles in prop::array::uniform3(-3.0..3.0), grey in any::<bool>(), start in 1..9_u32,
    ) {
        let depth = if grey { Depth::Grey } else { Depth::Bit };
        let mesh = ball([0.0; 3], 500.0, 2).moved(turn(angles), CENTRE).and(&cuboid([700.0; 3], [1300.0; 3]));
        let part = Part::new(&mesh, depth, UPRIGHT, 47.0);
        let layers = part.layers(1, 0);
        prop_assert!(layers == part.layers(3, 0));
        prop_assert!(layers[start as usize..] == part.layers(2, start)[..]);
    }
}

#[test]
fn pixels_on_a_grid_of_edges_are_drawn_once() {
    // All sides lie on centres of pixels and middles of layers. Each side of the box decides in the same way.
    let side = |first: f64, axis: usize| (first + 0.5) * PIXEL_UM[axis];
    for (columns, rows) in [(8.0, 8.0), (1.0, 3.0), (40.0, 11.0)] {
        let low = [side(10.0, 0), side(20.0, 1), 0.0];
        let high = [side(10.0 + columns, 0), side(20.0 + rows, 1), 600.0];
        let part = Part::new(&cuboid(low, high), Depth::Bit, UPRIGHT, 60.0);
        for bitmap in part.layers(1, 0) {
            let count =
                (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))).filter(|(x, y)| lit(&bitmap, *x, *y)).count();
            assert_eq!(count as f64, columns * rows, "a border belongs to one of its sides");
        }
    }
}

#[test]
fn overlapping_pieces_are_one_solid_and_a_reversed_shell_is_a_cavity() {
    let at = |x: f64| [1200.0 + x, 1080.0, 900.0];
    let [one, other] = [ball(at(-150.0), 400.0, 2), ball(at(200.0), 300.0, 3)];
    let cavity = ball(at(-250.0), 150.0, 1);
    let mesh = one.clone().and(&other).and(&cavity.clone().reversed());
    let part = Part::new(&mesh, Depth::Bit, UPRIGHT, 60.0);
    part.assert_solid(|point| {
        let union = inside_convex(&one, point).max(inside_convex(&other, point));
        union.min(-inside_convex(&cavity, point))
    });
}

#[test]
fn a_cavity_that_another_piece_reaches_is_filled_there() {
    // The winding number of the cavity is 0 without the other piece, and 1 within it.
    let (outer, cavity) = (cuboid([300.0; 3], [1500.0; 3]), cuboid([600.0; 3], [1200.0; 3]));
    let other = cuboid([1000.0, 700.0, 500.0], [1900.0, 900.0, 1400.0]);
    let mesh = outer.clone().and(&cavity.clone().reversed()).and(&other);
    let part = Part::new(&mesh, Depth::Bit, UPRIGHT, 60.0);
    part.assert_solid(|point| {
        let shell = inside_convex(&outer, point).min(-inside_convex(&cavity, point));
        shell.max(inside_convex(&other, point))
    });
}

#[test]
fn walls_keep_their_sides_however_thin_they_are() {
    // A ten millionth of a pixel thick: lit where it covers a centre, and nowhere else.
    let thickness = 2e-6;
    for (offset, expected) in [(0.0, 30), (7.0, 0)] {
        let x = 50.5 * PIXEL_UM[0] + offset;
        let wall = cuboid([x - thickness / 2.0, 242.0, 0.0], [x + thickness / 2.0, 242.0 + 30.0 * PIXEL_UM[1], 600.0]);
        let part = Part::new(&wall, Depth::Bit, UPRIGHT, 60.0);
        for bitmap in part.layers(1, 0) {
            let count: u32 = bitmap.data().iter().map(|byte| byte.count_ones()).sum();
            assert_eq!(count, expected, "{offset} µm beside the centre");
        }
    }
}

#[test]
fn a_gap_of_a_pixel_and_a_half_stays_open_and_two_near_balls_stay_apart() {
    let gap = 1.5 * PIXEL_UM[0];
    let [low, high] = [cuboid([200.0; 3], [900.0; 3]), cuboid([900.0 + gap, 200.0, 200.0], [1600.0, 900.0, 900.0])];
    let part = Part::new(&low.clone().and(&high), Depth::Bit, UPRIGHT, 60.0);
    part.assert_solid(|point| inside_convex(&low, point).max(inside_convex(&high, point)));
    let [one, other] = [ball([700.0, 1000.0, 500.0], 400.0, 3), ball([1600.0, 1000.0, 500.0], 400.0, 3)];
    let part = Part::new(&one.clone().and(&other), Depth::Bit, UPRIGHT, 60.0);
    part.assert_solid(|point| inside_convex(&one, point).max(inside_convex(&other, point)));
}

#[test]
fn twenty_pieces_at_one_place_lose_no_pixel() {
    let piece = ball([1000.0, 1000.0, 600.0], 500.0, 2);
    let many = (1..20).fold(piece.clone(), |many, _| many.and(&piece));
    let [one, twenty] = [&piece, &many].map(|mesh| Part::new(mesh, Depth::Bit, UPRIGHT, 60.0).layers(1, 0));
    assert_eq!(one, twenty);
}

#[test]
fn a_row_that_is_crossed_without_end_is_still_exact() {
    // More crossings in a row than are kept. Half of the pieces are cavities.
    let piece = cuboid([1000.0, 1000.0, 0.0], [1410.0, 1333.0, 90.0]).moved(turn([0.0, 0.0, 0.1]), DVec3::ZERO);
    let reversed = piece.clone().reversed();
    let mut many = piece.clone();
    (0..4500).for_each(|_| [&piece, &reversed].into_iter().for_each(|piece| many.0.extend_from_slice(&piece.0)));
    for depth in [Depth::Bit, Depth::Grey] {
        let [one, many] = [&piece, &many].map(|mesh| Part::new(mesh, depth, UPRIGHT, 60.0).layers(1, 0));
        assert!(one == many, "{depth:?}");
    }
}

#[test]
fn a_sheet_without_thickness_and_a_body_inside_out_print_nothing() {
    let square = [[400.0, 400.0], [1400.0, 500.0], [1300.0, 1500.0]].map(|[x, y]| DVec3::new(x, y, x / 3.0));
    let sheet = Mesh(vec![square, [square[0], square[2], square[1]]]);
    let inside_out = cuboid([1500.0, 500.0, 100.0], [1900.0, 900.0, 700.0]).reversed();
    // It needs something solid to be a part.
    let foot = cuboid([100.0, 100.0, 100.0], [300.0, 300.0, 700.0]);
    let part = Part::new(&sheet.and(&inside_out).and(&foot), Depth::Bit, UPRIGHT, 60.0);
    part.assert_solid(|point| inside_convex(&foot, point));
}

#[test]
fn flat_triangles_and_fans_leave_no_streaks() {
    // A box whose top is a fan of slivers around a corner, with a triangle without area between each two.
    let foot = cuboid([400.0, 400.0, 0.0], [1400.0, 1400.0, 600.0]);
    let is_top = |triangle: &&[DVec3; 3]| triangle.iter().all(|corner| corner.z > 0.0);
    let mut mesh = Mesh(foot.0.iter().filter(|triangle| !is_top(triangle)).copied().collect());
    let [a, b, c, d] =
        [[400.0, 400.0], [1400.0, 400.0], [1400.0, 1400.0], [400.0, 1400.0]].map(|[x, y]| DVec3::new(x, y, 600.0));
    let edge = |step: u32| c + (d - c) * f64::from(step) / 50.0;
    mesh.0.push([a, b, c]);
    for step in 0..50 {
        mesh.0.push([a, edge(step), edge(step + 1)]);
        // Without area, in both directions.
        mesh.0.push([a, edge(step), a.lerp(edge(step), 0.5)]);
        mesh.0.push([a, a.lerp(edge(step), 0.5), edge(step)]);
    }
    // The side below has its long edge undivided: the crack is closed by a triangle without height.
    for step in 0..50 {
        mesh.0.push([c, edge(step + 1), edge(step)]);
    }
    let turned = mesh.moved(turn([0.7, 0.4, 0.2]), DVec3::new(200.0, 300.0, 800.0));
    let solid = foot.moved(turn([0.7, 0.4, 0.2]), DVec3::new(200.0, 300.0, 800.0));
    let part = Part::new(&turned, Depth::Bit, UPRIGHT, 23.0);
    for (layer, bitmap) in part.layers(1, 0).iter().enumerate() {
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let excess_um = inside_convex(&solid, part.point(x, y, layer));
            assert!(
                lit(bitmap, x, y) == (excess_um > 0.0) || excess_um.abs() < 1e-3,
                "{layer}: {x}, {y}: {excess_um} µm"
            );
        }
    }
}

#[test]
fn grey_is_the_covered_share_of_a_pixel() {
    let mesh = cuboid([-300.0; 3], [300.0; 3]).moved(DMat3::from_rotation_z(0.4), CENTRE);
    let part = Part::new(&mesh, Depth::Grey, UPRIGHT, 60.0);
    let layers = part.layers(1, 0);
    let bitmap = &layers[5];
    let pixel_um2 = PIXEL_UM[0] * PIXEL_UM[1];
    let area_um2: f64 = bitmap.data().iter().map(|grey| f64::from(*grey) / 255.0 * pixel_um2).sum();
    assert!((area_um2 / 360_000.0 - 1.0).abs() < 2e-3, "{area_um2} µm²");
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let excess_um = inside_convex(&mesh, part.point(x, y, 5));
        let grey = bitmap.data()[y as usize * bitmap.stride_bytes() + x as usize];
        let expected = if excess_um > 20.0 {
            Some(255)
        } else if excess_um < -25.0 {
            Some(0)
        } else {
            None
        };
        assert!(expected.is_none_or(|expected| grey == expected), "{x}, {y}: {grey}, {excess_um} µm");
    }
}
