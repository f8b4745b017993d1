//! What an inspection finds in layers, and what it does not name.

use std::time::Duration;

use glam::{DMat3, DVec3};
use layerd::layer::Depth;
use layerd::slice::Inspection;

use crate::shapes::{Mesh, ball, cuboid, cylinder, turn};
use crate::{PIXEL_UM, Part, UPRIGHT};

const CENTRE: DVec3 = DVec3::new(1200.0, 1080.0, 0.0);

fn inspected(mesh: &Mesh) -> (Part, Inspection) {
    let part = Part::new(mesh, Depth::Bit, UPRIGHT, 60.0);
    let found = Inspection::of(|| part.bodies(), &part.plan, 2, Duration::from_secs(600), |_| {});
    let found = found.expect("it can be drawn");
    assert_eq!(found.looked_at, part.plan.layer_count);
    (part, found)
}

/// A block, and on its side, from one height to another, a fin of this thickness.
fn finned(thickness_um: f64, [low, high]: [f64; 2], angle: f64, offset_um: f64) -> Mesh {
    let fin = cuboid([100.0, -thickness_um / 2.0, low], [700.0, thickness_um / 2.0, high]);
    let block = cuboid([-300.0, -300.0, 0.0], [200.0, 300.0, 900.0]);
    block.and(&fin).moved(DMat3::from_rotation_z(angle), CENTRE + DVec3::new(offset_um, offset_um, 0.0))
}

#[test]
fn walls_thinner_than_a_pixel_are_named_and_thicker_ones_are_not() {
    let quarter = std::f64::consts::FRAC_PI_2;
    for (turns, pitch_um) in [(0.0, PIXEL_UM[1]), (1.0, PIXEL_UM[0])] {
        for offset_um in [0.0, 3.0, 9.7] {
            for share in [0.05, 0.3, 0.6, 0.85] {
                // From the middle of layer 3 to that of layer 7, without its ends.
                let mesh = finned(share * pitch_um, [230.0, 460.0], turns * quarter, offset_um);
                let (_, found) = inspected(&mesh);
                // Thinner than the samples of a pixel, it may lie between them.
                if share > 0.2 {
                    assert_eq!(found.thin, [[4, 7]], "{share} of a pixel, moved by {offset_um} µm");
                    let thinnest = found.thinnest.expect("there is one");
                    assert!((thinnest.thickness_px - share).abs() < 0.14, "{thinnest:?}");
                }
            }
            for share in [1.0, 1.03, 1.5, 4.0] {
                let (_, found) = inspected(&finned(share * pitch_um, [230.0, 460.0], turns * quarter, offset_um));
                assert_eq!((found.thin, found.thinnest), (vec![], None), "{share} of a pixel, moved by {offset_um} µm");
            }
        }
    }
}

#[test]
fn slanted_walls_are_measured_along_rows_or_columns() {
    for degrees in [3.0_f64, 20.0, 45.0, 70.0, 88.0] {
        let angle = degrees.to_radians();
        // How long a pixel's width of a row or a column is across the wall.
        let least_um = (PIXEL_UM[0] * angle.sin()).max(PIXEL_UM[1] * angle.cos());
        let most_um = PIXEL_UM[0].hypot(PIXEL_UM[1]);
        let (_, found) = inspected(&finned(0.6 * least_um.min(PIXEL_UM[0]), [230.0, 460.0], angle, 5.0));
        assert_eq!(found.thin, [[4, 7]], "{degrees}°");
        let (_, found) = inspected(&finned(1.05 * most_um, [230.0, 460.0], angle, 5.0));
        assert_eq!(found.thin, [[0; 2]; 0], "{degrees}°");
    }
}

#[test]
fn tips_edges_and_round_bodies_are_no_walls() {
    let centre = CENTRE + DVec3::Z * 700.0;
    for mesh in [
        ball(centre.to_array(), 600.0, 4),
        ball(centre.to_array(), 30.0, 2),
        cuboid([-300.0; 3], [300.0; 3]).moved(turn([0.5, 0.7, 0.3]), centre),
        cylinder(400.0, [-600.0, 600.0], 90).moved(turn([1.3, 0.2, 0.0]), centre),
        // Lying, and so that its upper edge is a ridge of 90°.
        cylinder(400.0, [-600.0, 600.0], 90).moved(turn([std::f64::consts::FRAC_PI_2, 0.0, 0.3]), centre),
        cuboid([-300.0; 3], [300.0; 3]).moved(turn([std::f64::consts::FRAC_PI_4, 0.0, 0.3]), centre - DVec3::Z * 21.0),
        cuboid([-300.0; 3], [100.0; 3]).and(&cuboid([0.0; 3], [400.0; 3])).moved(turn([0.1, 0.2, 0.3]), centre),
    ] {
        assert_eq!(inspected(&mesh).1.thin, [[0; 2]; 0]);
    }
}

#[test]
fn what_is_enclosed_more_than_once_is_told() {
    let at = [1200.0, 1080.0, 600.0];
    let (outer, inner) = (ball(at, 500.0, 3), ball(at, 200.0, 3));
    let (part, found) = inspected(&outer.clone().and(&inner));
    let is_within = |layer: &u32| (part.plan.layer_z_um(*layer) - 600.0).abs() < 200.0;
    let layers: Vec<_> = (0..part.plan.layer_count).filter(is_within).collect();
    assert_eq!(found.enclosed_twice, [[layers[0], layers[layers.len() - 1]]]);
    let (_, cavity) = inspected(&outer.clone().and(&inner.reversed()));
    assert_eq!(cavity.enclosed_twice, [[0; 2]; 0]);
    let beside = ball([2100.0, 1080.0, 600.0], 300.0, 2);
    let (_, apart) = inspected(&outer.clone().and(&beside));
    assert_eq!(apart.enclosed_twice, [[0; 2]; 0]);
    let (_, overlapping) = inspected(&outer.and(&ball([1700.0, 1080.0, 600.0], 300.0, 3)));
    assert_eq!(overlapping.enclosed_twice.len(), 1);
}

#[test]
fn without_time_the_first_and_the_last_layer_are_looked_at() {
    let part = Part::new(&finned(10.0, [0.0, 900.0], 0.0, 3.0), Depth::Bit, UPRIGHT, 60.0);
    let mut told = Vec::new();
    let found = Inspection::of(|| part.bodies(), &part.plan, 1, Duration::ZERO, |layer| told.push(layer));
    let found = found.expect("it can be drawn");
    assert_eq!(told, [0, 14]);
    assert_eq!((found.looked_at, found.thin), (2, vec![[0, 14]]), "a layer stands for those up to the next");
}
