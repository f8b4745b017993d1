//! Undisplaced solids against exact signed distances, and against themselves as patches.

use glam::DVec3;
use layerd::layer::Depth;

use crate::objects::{Object, ball, cuboid, torus};
use crate::{PLAIN, Part, Recipe, map};

/// By how much a point lies inside, millimetres.
type Distance<'a> = &'a dyn Fn(DVec3) -> f64;

#[test]
fn a_ball_a_box_and_a_torus_are_where_their_distance_is_0() {
    let (large, small) = (1.6, 0.5);
    let curved = Recipe { is_curved: true, ..PLAIN };
    let box_distance = |at: DVec3| (DVec3::splat(1.3) - at).min(at).min_element();
    let torus_distance = |at: DVec3| small - (at.truncate().length() - large).hypot(at.z);
    let cases: [(&str, Object, Distance<'_>); 3] = [
        ("ball", ball(1.7, 40, 80), &|at| 1.7 - at.length()),
        ("box", cuboid([1.3; 3]), &box_distance),
        ("torus", torus(large, small, [96, 48]), &torus_distance),
    ];
    for (name, object, inside) in cases {
        let part = Part::new(&object, &curved);
        let farthest = part.farthest_mm(&part.plan(Depth::Bit), inside);
        assert!(farthest < 0.0012, "{name}: {farthest} mm, 0.03 voxels are 0.0012");
    }
}

#[test]
fn a_black_map_changes_nothing() {
    let black = map([16, 16], |_| 0.0);
    for rotate_deg in [[0.0; 3], [33.0, 11.0, 77.0]] {
        let object = torus(1.6, 0.5, [40, 20]);
        let plain = Part::new(&object, &Recipe { rotate_deg, ..PLAIN });
        let displaced = Part::new(&object, &Recipe { map: Some(&black), rotate_deg, ..PLAIN });
        let plan = plain.plan(Depth::Bit);
        assert_eq!(plain.file.header().bounds, displaced.file.header().bounds);
        assert!(plain.layers(&plan, 2, 0) == displaced.layers(&plan, 2, 0));
    }
}
