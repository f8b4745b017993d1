//! Where a film leaves a strut it is the strut's cylinder, and as smooth. The end of a single strut is half of a ball.

use std::collections::HashSet;

use glam::DVec3;
use layerd::solid::soap::FilmMesh;

use crate::node_shapes::measure::points;
use crate::node_shapes::{Random, regular};
use crate::{mesh, outline, random, special, unit};

/// The vertices of the circle of a strut and those beside them.
fn beside_rim(mesh: &FilmMesh, strut: usize) -> HashSet<u32> {
    let rim: HashSet<u32> = mesh.rim(strut).iter().copied().collect();
    let near = mesh.triangles().iter().filter(|corners| corners.iter().any(|corner| rim.contains(corner)));
    near.copied().flatten().collect()
}

#[test]
fn circles_and_the_ring_beside_them_lie_on_the_cylinder() {
    for directions in special().into_iter().map(|(_, directions)| directions).chain(random(40, 15.0)) {
        let cuts = outline(&directions).cuts;
        for steps in 0..=3 {
            let mesh = mesh(&directions, steps);
            let points = points(&mesh);
            for (strut, direction) in directions.iter().enumerate() {
                let axis = unit(*direction);
                for vertex in beside_rim(&mesh, strut) {
                    let point = points[vertex as usize];
                    let distance = (point - axis * point.dot(axis)).length();
                    assert!((distance - 1.0).abs() < 1e-14, "{distance} at level {steps}");
                }
                for (at, vertex) in mesh.rim(strut).iter().enumerate() {
                    let (point, normal) = (points[*vertex as usize], DVec3::from(mesh.normals()[*vertex as usize]));
                    assert!((point.dot(axis) - cuts[strut]).abs() < 1e-13 * cuts[strut]);
                    assert!((normal - (point - axis * cuts[strut])).length() < 1e-13 * cuts[strut]);
                    let next = points[mesh.rim(strut)[(at + 1) % mesh.rim(strut).len()] as usize];
                    assert!(point.cross(next).dot(axis) > 0.0, "the circle runs clockwise");
                }
            }
        }
    }
}

/// The greatest angle between the cylinder's normals and those of the triangles at the circles, area-weighted as in the control mesh.
fn rim_error_degrees(mesh: &FilmMesh) -> f64 {
    let points = points(mesh);
    let mut normals = vec![DVec3::ZERO; points.len()];
    for corners in mesh.triangles() {
        let [a, b, c] = corners.map(|corner| points[corner as usize]);
        corners.iter().for_each(|corner| normals[*corner as usize] += (b - a).cross(c - a));
    }
    let rims = (0..mesh.rim_count()).flat_map(|strut| mesh.rim(strut)).map(|vertex| *vertex as usize);
    let error =
        |vertex: usize| normals[vertex].normalize().dot(DVec3::from(mesh.normals()[vertex])).acos().to_degrees();
    rims.map(error).fold(0.0, f64::max)
}

/// They halve with every level, as the triangles do: the surface is smooth in the limit.
#[test]
fn normals_at_the_circles_become_those_of_the_cylinder() {
    for count in [6, 12, 20] {
        let errors = [0, 1, 2, 3, 4].map(|steps| rim_error_degrees(&mesh(&regular(count), steps)));
        assert!(errors[0] < 6.5, "{count} struts: {errors:.2?}");
        for pair in errors.windows(2) {
            assert!(pair[1] < 0.6 * pair[0], "{count} struts: {errors:.2?}");
        }
    }
}

#[test]
fn the_end_of_a_single_strut_is_half_of_a_ball() {
    let mut random = Random(5);
    for direction in [[0.0, 0.0, 1.0], [0.0, 0.0, -3.0], random.direction(), random.direction()] {
        for steps in 0..=4 {
            let mesh = mesh(&[direction], steps);
            for (vertex, normal) in points(&mesh).iter().zip(mesh.normals()) {
                assert!((vertex.length() - 1.0).abs() < 4e-15);
                assert!((*vertex - DVec3::from(*normal)).length() < 4e-15);
                assert!(vertex.dot(unit(direction)) < 1e-15);
            }
        }
        assert_eq!(outline(&[direction]).cuts, [0.0]);
    }
}
