//! Thin, near and nested: what must neither vanish, nor merge, nor leave traces.

use glam::{DMat3, DVec3};
use layerd::buildfile::Joint;
use layerd::layer::Depth;
use layerd::slice::scan::Contours;
use layerd::stream::MemoryBudget;

use crate::shapes::{Mesh, ball, cuboid, cylinder, inside_convex, turn};
use crate::slice_part::{Part as Struts, strut};
use crate::{HEIGHT, PIXEL_UM, Part, UPRIGHT, WIDTH, lit};

const CENTRE: DVec3 = DVec3::new(1200.0, 1080.0, 500.0);

/// Number of lit pixels of each layer.
fn counts(part: &Part) -> Vec<u32> {
    part.layers(1, 0).iter().map(|bitmap| bitmap.data().iter().map(|byte| byte.count_ones()).sum()).collect()
}

#[test]
fn two_balls_a_tenth_of_a_millimetre_apart_never_merge() {
    for angle in [0.0, 0.4, 0.9, std::f64::consts::FRAC_PI_2] {
        let along = DMat3::from_rotation_z(angle) * DVec3::X;
        let [one, other] =
            [ball((CENTRE - along * 450.0).to_array(), 400.0, 2), ball((CENTRE + along * 450.0).to_array(), 400.0, 2)];
        let part = Part::new(&one.clone().and(&other), Depth::Bit, UPRIGHT, 31.0);
        part.assert_solid(|point| inside_convex(&one, point).max(inside_convex(&other, point)));
        // For a laser: two regions without holes in every layer.
        let budget = MemoryBudget::new(Contours::memory_bytes(&part.bodies(), &part.plan, 1) + (16 << 20));
        let mut contours = Contours::new(part.bodies(), part.plan.clone(), 0.0, 1, 0, &budget).expect("contours");
        let mut seen = 0;
        while let Some(layer) = contours.next_layer().expect("a layer") {
            assert_eq!(layer.regions().len(), 2, "{layer:?}");
            assert!(layer.regions().iter().all(|region| region.holes.is_empty()));
            seen += 1;
        }
        assert_eq!(seen, part.plan.layer_count);
    }
}

#[test]
fn a_gap_of_a_pixel_and_a_half_stays_open_along_both_axes() {
    for (turns, pitch_um) in [(0.0, PIXEL_UM[0]), (1.0, PIXEL_UM[1])] {
        for offset_um in [0.0, 3.0, 11.0, 17.0] {
            let half_um = 0.75 * pitch_um;
            let sides = cuboid([half_um, -300.0, -400.0], [500.0, 300.0, 400.0])
                .and(&cuboid([-500.0, -300.0, -400.0], [-half_um, 300.0, 400.0]));
            let turned = DMat3::from_rotation_z(turns * std::f64::consts::FRAC_PI_2);
            let part = Part::new(&sides.moved(turned, CENTRE + DVec3::splat(offset_um)), Depth::Bit, UPRIGHT, 60.0);
            for bitmap in part.layers(1, 0) {
                // From one side to the other there is at least one dark pixel.
                let dark = |x: u32, y: u32| !lit(&bitmap, x, y);
                let (column, row) = ((CENTRE.x / PIXEL_UM[0]) as u32, (CENTRE.y / PIXEL_UM[1]) as u32);
                if turns == 0.0 {
                    assert!((row - 9..row + 9).all(|y| (column - 2..column + 4).any(|x| dark(x, y))), "{offset_um} µm");
                } else {
                    assert!((column - 9..column + 9).all(|x| (row - 2..row + 4).any(|y| dark(x, y))), "{offset_um} µm");
                }
            }
        }
    }
}

#[test]
fn a_fin_of_one_pixel_is_in_every_layer() {
    for (turns, pitch_um, rows) in [(0.0, PIXEL_UM[1], 600.0 / PIXEL_UM[0]), (1.0, PIXEL_UM[0], 600.0 / PIXEL_UM[1])] {
        for offset_um in [0.0, 1.0, 6.3, 12.0, 19.9] {
            let fin = cuboid([-300.0, -pitch_um / 2.0, -420.0], [300.0, pitch_um / 2.0, 420.0]);
            let turned = DMat3::from_rotation_z(turns * std::f64::consts::FRAC_PI_2);
            let part = Part::new(
                &fin.moved(turned, CENTRE + DVec3::new(offset_um, offset_um, 0.0)),
                Depth::Bit,
                UPRIGHT,
                60.0,
            );
            for (layer, count) in counts(&part).into_iter().enumerate() {
                // It is one pixel wide all along: its ends may cover a centre more or less.
                assert!((f64::from(count) - rows).abs() <= 1.0, "layer {layer}, {offset_um} µm: {count} pixels");
            }
        }
    }
    // Slanted, along a row or a column each of its cuts is longer than a pixel: every row or every column has a pixel.
    for degrees in [10.0_f64, 45.0, 80.0] {
        let fin = cuboid([-400.0, -12.0, -420.0], [400.0, 12.0, 420.0]);
        let part =
            Part::new(&fin.moved(DMat3::from_rotation_z(degrees.to_radians()), CENTRE), Depth::Bit, UPRIGHT, 60.0);
        for bitmap in part.layers(1, 0) {
            let has_row = |y: u32| (0..WIDTH).any(|x| lit(&bitmap, x, y));
            let has_column = |x: u32| (0..HEIGHT).any(|y| lit(&bitmap, x, y));
            let reach = |length: f64, pitch_um: f64| (0.9 * 400.0 * length / pitch_um) as u32;
            let (sin, cos) = degrees.to_radians().sin_cos();
            let (column, row) = ((CENTRE.x / PIXEL_UM[0]) as u32, (CENTRE.y / PIXEL_UM[1]) as u32);
            let [columns, rows] = [reach(cos, PIXEL_UM[0]), reach(sin, PIXEL_UM[1])];
            let is_whole = if degrees < 45.0 {
                (column - columns..column + columns).all(has_column)
            } else {
                (row - rows..row + rows).all(has_row)
            };
            assert!(is_whole, "{degrees}°");
        }
    }
}

#[test]
fn twenty_cylinders_or_struts_at_one_place_lose_no_pixel() {
    for angles in [[0.0; 3], [0.6, 0.2, 0.9]] {
        let one = cylinder(250.0, [-300.0, 300.0], 40).moved(turn(angles), CENTRE);
        let twenty = (1..20).fold(one.clone(), |many, _| many.and(&one));
        for depth in [Depth::Bit, Depth::Grey] {
            let [one, twenty] = [&one, &twenty].map(|mesh| Part::new(mesh, depth, UPRIGHT, 60.0).layers(1, 0));
            assert!(one == twenty, "{depth:?}");
        }
    }
    for depth in [Depth::Bit, Depth::Grey] {
        let one = strut([300, 400, 0], [1500, 900, 700], 120, 80);
        let [one, twenty] =
            [1, 20].map(|count| Struts::new(&vec![one; count], Joint::Union, depth, UPRIGHT, 60.0).layers(1, 0));
        assert!(one == twenty, "{depth:?}");
    }
}

#[test]
fn a_shell_within_another_that_faces_the_same_way_changes_nothing() {
    let (outer, inner) = (ball(CENTRE.to_array(), 450.0, 3), ball(CENTRE.to_array(), 200.0, 2));
    let innermost = ball(CENTRE.to_array(), 90.0, 2);
    let alone = Part::new(&outer, Depth::Bit, UPRIGHT, 60.0).layers(1, 0);
    let layers = |mesh: &Mesh| Part::new(mesh, Depth::Bit, UPRIGHT, 60.0).layers(1, 0);
    assert!(layers(&outer.clone().and(&inner)) == alone);
    assert!(layers(&outer.clone().and(&inner).and(&innermost)) == alone);
    // Turned inside out, it is a cavity; and what faces outwards in the cavity is solid again.
    let part = Part::new(&outer.clone().and(&inner.clone().reversed()).and(&innermost), Depth::Bit, UPRIGHT, 60.0);
    part.assert_solid(|point| {
        let shell = inside_convex(&outer, point).min(-inside_convex(&inner, point));
        shell.max(inside_convex(&innermost, point))
    });
}

#[test]
fn pieces_that_overlap_have_a_core_and_no_inner_walls() {
    // A cross of three bars, a part of which is enclosed three times.
    let bar = |axis: usize| {
        let half = [0, 1, 2].map(|other| if other == axis { 400.0 } else { 150.0 });
        cuboid(half.map(|um: f64| -um), half).moved(turn([0.3, 0.2, 0.5]), CENTRE)
    };
    let bars = [bar(0), bar(1), bar(2)];
    let mesh = bars.iter().fold(Mesh::default(), Mesh::and);
    let part = Part::new(&mesh, Depth::Bit, UPRIGHT, 47.0);
    part.assert_solid(|point| bars.iter().map(|bar| inside_convex(bar, point)).fold(f64::MIN, f64::max));
    let grey = Part::new(&mesh, Depth::Grey, UPRIGHT, 47.0);
    for (layer, bitmap) in grey.layers(1, 0).iter().enumerate() {
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let inside = bars.iter().map(|bar| inside_convex(bar, grey.point(x, y, layer))).fold(f64::MIN, f64::max);
            let value = bitmap.data()[y as usize * bitmap.stride_bytes() + x as usize];
            assert!(inside < 20.0 || value == 255, "layer {layer}, {x}, {y}: {value}, {inside} µm inside");
        }
    }
}
