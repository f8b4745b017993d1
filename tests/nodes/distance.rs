//! Distances of points from triangles, and points of PN triangles.

use std::collections::HashMap;

use glam::DVec3;
use layerd::solid::soap::FilmMesh;

use crate::node_shapes::measure::points;

/// The greatest distance of points from a mesh, of those that are farther than `bound`; `bound` if none is.
pub(crate) fn greatest_distance(mesh: &FilmMesh, from: impl Iterator<Item = DVec3>, bound: f64) -> f64 {
    let points = points(mesh);
    let triangles: Vec<_> = mesh.triangles().iter().map(|names| names.map(|name| points[name as usize])).collect();
    // Each triangle is in the cells that anything within the bound of it may touch.
    let size = 0.1 + bound;
    let cell = |point: DVec3| (point / size).floor().to_array().map(|part| part as i32);
    let mut cells: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
    for (number, [a, b, c]) in triangles.iter().enumerate() {
        let (from, to) = (cell(a.min(*b).min(*c) - bound), cell(a.max(*b).max(*c) + bound));
        for x in from[0]..=to[0] {
            for y in from[1]..=to[1] {
                (from[2]..=to[2]).for_each(|z| cells.entry([x, y, z]).or_default().push(number));
            }
        }
    }
    let mut greatest = bound;
    for point in from {
        let near = cells.get(&cell(point)).map_or(&[][..], Vec::as_slice);
        if !near.iter().any(|number| distance(point, triangles[*number]) <= bound) {
            let nearest = triangles.iter().map(|corners| distance(point, *corners)).fold(f64::INFINITY, f64::min);
            greatest = greatest.max(nearest);
        }
    }
    greatest
}

/// Distance of a point from a triangle.
fn distance(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let foot = point - normal * (point - a).dot(normal);
    let is_inside = |u: DVec3, v: DVec3| (v - u).cross(foot - u).dot(normal) >= 0.0;
    if is_inside(a, b) && is_inside(b, c) && is_inside(c, a) {
        return point.distance(foot);
    }
    let from_side = |u: DVec3, v: DVec3| {
        let share = ((point - u).dot(v - u) / (v - u).length_squared()).clamp(0.0, 1.0);
        point.distance(u.lerp(v, share))
    };
    from_side(a, b).min(from_side(b, c)).min(from_side(c, a))
}

/// A point of the cubic through three corners with their normals, at these weights (Vlachos et al. 2001, §3.1).
pub(crate) fn curved_point(corners: [DVec3; 3], normals: [DVec3; 3], weights: [f64; 3]) -> DVec3 {
    let mut point = DVec3::ZERO;
    let mut edges = DVec3::ZERO;
    for at in 0..3 {
        let next = (at + 1) % 3;
        point += corners[at] * weights[at].powi(3);
        for [from, to] in [[at, next], [next, at]] {
            let along = (corners[to] - corners[from]).dot(normals[from]);
            let control = (corners[from] * 2.0 + corners[to] - normals[from] * along) / 3.0;
            point += control * (3.0 * weights[from] * weights[from] * weights[to]);
            edges += control;
        }
    }
    let middle = edges / 4.0 - corners.iter().sum::<DVec3>() / 6.0;
    point + middle * (6.0 * weights[0] * weights[1] * weights[2])
}
