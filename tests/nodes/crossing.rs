//! Whether triangles of a mesh cross each other.

use std::collections::HashMap;

use glam::DVec3;
use layerd::solid::soap::FilmMesh;

use crate::node_shapes::measure::points;

/// A triangle: its corners, and what tells them from others.
struct Piece {
    corners: [DVec3; 3],
    names: [(usize, u32); 3],
}

impl Piece {
    fn bounds(&self) -> [DVec3; 2] {
        let [a, b, c] = self.corners;
        [a.min(b).min(c), a.max(b).max(c)]
    }
}

/// Pairs of triangles without a common corner that cross: one has an edge that passes through the other.
pub(crate) fn crossings(mesh: &FilmMesh) -> usize {
    crossings_of(&[mesh])
}

/// The same of several meshes laid over each other.
pub(crate) fn crossings_of(meshes: &[&FilmMesh]) -> usize {
    let pieces: Vec<Piece> = meshes.iter().enumerate().flat_map(|(number, mesh)| pieces(number, mesh)).collect();
    // Cells a little larger than most triangles.
    let extents = pieces.iter().map(|piece| (piece.bounds()[1] - piece.bounds()[0]).max_element());
    let size = extents.sum::<f64>() / pieces.len() as f64 * 1.5;
    let mut cells: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
    let mut found = 0;
    for (number, piece) in pieces.iter().enumerate() {
        let mut near = Vec::new();
        for cell in cells_of(piece, size) {
            let cell = cells.entry(cell).or_default();
            near.extend(cell.iter().copied());
            cell.push(number);
        }
        near.sort_unstable();
        near.dedup();
        found += near.into_iter().filter(|other| do_cross(piece, &pieces[*other])).count();
    }
    found
}

fn pieces(number: usize, mesh: &FilmMesh) -> impl Iterator<Item = Piece> {
    let points = points(mesh);
    mesh.triangles().iter().map(move |names| Piece {
        corners: names.map(|name| points[name as usize]),
        names: names.map(|name| (number, name)),
    })
}

/// The cells of this size that a triangle's box touches.
fn cells_of(piece: &Piece, size: f64) -> Vec<[i32; 3]> {
    let [from, to] = piece.bounds().map(|corner| (corner / size).floor().to_array().map(|part| part as i32));
    let mut cells = Vec::new();
    for x in from[0]..=to[0] {
        for y in from[1]..=to[1] {
            cells.extend((from[2]..=to[2]).map(|z| [x, y, z]));
        }
    }
    cells
}

fn do_cross(a: &Piece, b: &Piece) -> bool {
    let ([low, high], [other_low, other_high]) = (a.bounds(), b.bounds());
    let is_apart = low.cmpgt(other_high).any() || other_low.cmpgt(high).any();
    if is_apart || a.names.iter().any(|name| b.names.contains(name)) {
        return false;
    }
    let passes = |from: &[DVec3; 3], through: &[DVec3; 3]| {
        (0..3).any(|side| passes_through(from[side], from[(side + 1) % 3], through))
    };
    passes(&a.corners, &b.corners) || passes(&b.corners, &a.corners)
}

/// Whether the line from `from` to `to` passes through a triangle (Möller & Trumbore 1997).
fn passes_through(from: DVec3, to: DVec3, [a, b, c]: &[DVec3; 3]) -> bool {
    let (line, u, v) = (to - from, *b - *a, *c - *a);
    let across = line.cross(v);
    let volume = u.dot(across);
    // Triangles of one flat side of a cylinder lie in one plane, and touch along edges.
    if volume.abs() <= 1e-9 * line.length() * u.length() * v.length() {
        return false;
    }
    let start = from - *a;
    let first = start.dot(across) / volume;
    let turned = start.cross(u);
    let second = line.dot(turned) / volume;
    let along = v.dot(turned) / volume;
    first >= 0.0 && second >= 0.0 && first + second <= 1.0 && (0.0..=1.0).contains(&along)
}
