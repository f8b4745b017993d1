//! How far a mesh is from the struts' cylinders and ball, and how much it is bent.

use glam::DVec3;
use layerd::solid::soap::FilmMesh;

pub(crate) fn points(mesh: &FilmMesh) -> Vec<DVec3> {
    mesh.vertices().iter().copied().map(DVec3::from).collect()
}

/// Distance of a point from the surface of struts of radius 1 and the ball at their node; exact outside.
pub(crate) fn deviation(point: DVec3, directions: &[[f64; 3]]) -> f64 {
    let axis_distance = |direction: &[f64; 3]| {
        let direction = DVec3::from(*direction).normalize();
        (point - direction * point.dot(direction).max(0.0)).length()
    };
    (directions.iter().map(axis_distance).fold(point.length(), f64::min) - 1.0).abs()
}

/// Mean, by area, and greatest distance of a mesh's vertices.
pub(crate) fn deviations(mesh: &FilmMesh, directions: &[[f64; 3]]) -> [f64; 2] {
    let points = points(mesh);
    let areas = areas(mesh, &points);
    let of = |vertex: usize| deviation(points[vertex], directions);
    let mean =
        areas.iter().enumerate().map(|(vertex, area)| area * of(vertex)).sum::<f64>() / areas.iter().sum::<f64>();
    [mean, (0..points.len()).map(of).fold(0.0, f64::max)]
}

/// A third of the area of the triangles around each vertex.
fn areas(mesh: &FilmMesh, points: &[DVec3]) -> Vec<f64> {
    let mut areas = vec![0.0; points.len()];
    for corners in mesh.triangles() {
        let [a, b, c] = corners.map(|corner| points[corner as usize]);
        let third = (b - a).cross(c - a).length() / 6.0;
        corners.iter().for_each(|corner| areas[*corner as usize] += third);
    }
    areas
}

/// The square of the mean curvature, integrated over the mesh but for its circles, by the cotangent formula (Meyer et al. 2003). It has no
/// unit; that of a sphere is 4π.
pub(crate) fn bending(mesh: &FilmMesh) -> f64 {
    let points = points(mesh);
    let areas = areas(mesh, &points);
    let mut doubled_normals = vec![DVec3::ZERO; points.len()];
    for corners in mesh.triangles() {
        for at in 0..3 {
            let [apex, a, b] = [0, 1, 2].map(|turn| corners[(at + turn) % 3] as usize);
            let [u, v] = [points[a] - points[apex], points[b] - points[apex]];
            let cotangent = u.dot(v) / u.cross(v).length();
            let pull = (points[a] - points[b]) * cotangent;
            doubled_normals[a] += pull;
            doubled_normals[b] -= pull;
        }
    }
    for vertex in (0..mesh.rim_count()).flat_map(|strut| mesh.rim(strut)) {
        doubled_normals[*vertex as usize] = DVec3::ZERO;
    }
    doubled_normals.iter().zip(areas).map(|(sum, area)| sum.length_squared() / (16.0 * area)).sum()
}
