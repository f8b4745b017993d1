//! Meshes are closed but for their circles, lie within their bounds, and never cross themselves.

use std::collections::HashSet;

use glam::DVec3;
use layerd::solid::soap::FilmMesh;

use crate::crossing::{crossings, crossings_of};
use crate::node_shapes::measure::points;
use crate::{level, mesh, outline, random, special, unfaired, unit};

/// Every edge has a triangle on both sides, and on one side along the circles, which come in order. With discs on its `struts` circles it
/// is a sphere, turned outwards.
fn check_closed(mesh: &FilmMesh, struts: usize, of: &str) {
    let sides = |[a, b, c]: [u32; 3]| [[a, b], [b, c], [c, a]];
    let mut open = HashSet::new();
    for side in mesh.triangles().iter().copied().flat_map(sides) {
        assert!(open.insert(side), "{of}: two triangles run along {side:?}");
    }
    let edges = open.len();
    let back = open.clone();
    open.retain(|[a, b]| !back.contains(&[*b, *a]));
    let edges = (edges - open.len()) / 2 + open.len();
    for strut in 0..struts {
        let rim = mesh.rim(strut);
        for (at, from) in rim.iter().enumerate() {
            // As seen from outside of the strut, the mesh is on the right of its circle.
            assert!(open.remove(&[rim[(at + 1) % rim.len()], *from]), "{of}: the circle of strut {strut} has a gap");
        }
    }
    assert!(open.is_empty(), "{of}: holes besides the circles: {open:?}");
    let characteristic = mesh.vertices().len() as i64 - edges as i64 + mesh.triangles().len() as i64;
    assert_eq!(characteristic, 2 - struts as i64, "{of}");
    assert!(volume(mesh, struts) > 0.5, "{of}: it is inside out");
}

/// Volume within a mesh and the discs on its circles.
fn volume(mesh: &FilmMesh, struts: usize) -> f64 {
    let points = points(mesh);
    let cone = |a: DVec3, b: DVec3, c: DVec3| a.dot(b.cross(c)) / 6.0;
    let sides = mesh.triangles().iter().map(|corners| {
        let [a, b, c] = corners.map(|corner| points[corner as usize]);
        cone(a, b, c)
    });
    let discs = (0..struts).flat_map(|strut| {
        let rim = mesh.rim(strut);
        let at = |place: usize| points[rim[place % rim.len()] as usize];
        let first = at(0);
        (1..rim.len()).map(move |place| cone(first, at(place), at(place + 1))).collect::<Vec<_>>()
    });
    sides.sum::<f64>() + discs.sum::<f64>()
}

#[test]
fn nodes_are_closed_but_for_their_circles() {
    for (name, directions) in special() {
        for steps in 0..=3 {
            check_closed(&mesh(&directions, steps), directions.len(), name);
        }
        check_closed(&unfaired(&directions, 0), directions.len(), name);
    }
    for directions in random(300, 12.0) {
        check_closed(&mesh(&directions, 1), directions.len(), "random");
    }
}

#[test]
fn the_outline_tells_sizes_bounds_and_memory() {
    for directions in special().into_iter().map(|(_, directions)| directions).chain(random(60, 12.0)) {
        let outline = outline(&directions);
        for steps in 0..=3 {
            let mesh = mesh(&directions, steps);
            assert_eq!(outline.size(level(steps)), [mesh.vertices().len(), mesh.triangles().len()]);
            let rims: usize = (0..directions.len()).map(|strut| mesh.rim(strut).len() + 1).sum();
            let bytes = size_of_val(mesh.vertices()) + size_of_val(mesh.normals()) + size_of_val(mesh.triangles());
            assert_eq!(outline.bytes(level(steps)), bytes + (rims + 1) * 4);
            for vertex in mesh.vertices() {
                let fits = |axis: usize| (outline.bounds[0][axis]..=outline.bounds[1][axis]).contains(&vertex[axis]);
                assert!((0..3).all(fits), "{vertex:?} is not within {:?}", outline.bounds);
            }
            let [low, high] = mesh.z_bounds();
            assert!(mesh.vertices().iter().all(|vertex| (low..=high).contains(&vertex[2])));
        }
    }
}

/// The film around a strut begins well behind its circle: λ leaves room for three rows.
#[test]
fn the_film_stays_behind_the_circles() {
    for directions in random(300, 12.0).chain([crate::regular(6), crate::regular(12), crate::regular(20)]) {
        let cuts = outline(&directions).cuts;
        let mesh = unfaired(&directions, 0);
        let points = points(&mesh);
        let columns: usize = (0..directions.len()).map(|strut| mesh.rim(strut).len()).sum();
        for (strut, direction) in directions.iter().enumerate() {
            let last_row: HashSet<_> = mesh.rim(strut).iter().map(|vertex| vertex + 3 * columns as u32).collect();
            let beside = mesh.triangles().iter().filter(|corners| corners.iter().any(|at| last_row.contains(at)));
            for vertex in beside.flatten().filter(|vertex| **vertex as usize >= 4 * columns) {
                let reach = points[*vertex as usize].dot(unit(*direction));
                // Vertices that became one may be off by 3°.
                assert!(reach <= cuts[strut] / 1.3 * 1.05, "{reach} of {}", cuts[strut]);
            }
        }
    }
}

#[test]
fn nodes_do_not_cross_themselves() {
    for (name, directions) in special() {
        assert_eq!(crossings(&mesh(&directions, 1)), 0, "{name}");
    }
    for (seed, directions) in random(300, 36.0).enumerate() {
        assert_eq!(crossings(&mesh(&directions, 1)), 0, "random {seed}");
    }
    for (seed, directions) in random(60, 10.01).enumerate() {
        assert_eq!(crossings(&mesh(&directions, 1)), 0, "narrow {seed}");
        assert_eq!(crossings(&mesh(&directions, 0)), 0, "narrow {seed}");
    }
}

#[test]
fn crossing_triangles_are_found() {
    // Two elbows laid over each other.
    let [one, other] = [[0.2, 1.0, 0.0], [0.2, 0.0, 1.0]].map(|second| mesh(&[[1.0, 0.0, 0.0], second], 0));
    assert_eq!((crossings(&one), crossings(&other)), (0, 0));
    assert!(crossings_of(&[&one, &other]) > 0);
}
