//! The mesh of a node, as others see it. `node` fills it, `benches/nodes.rs` and `tests/nodes/` read it.

use glam::DVec3;

use super::level::Level;
use super::surface::Surface;

/// The surface between the struts of a node: triangles around the node, bounded by a circle for each strut. Lengths are in the unit of the
/// node's radius, and the node lies at 0, 0, 0.
///
/// Triangles run counter-clockwise as seen from outside. Together with discs on all circles, they are a closed surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FilmMesh {
    pub(super) level: Level,
    pub(super) vertices: Vec<[f64; 3]>,
    pub(super) normals: Vec<[f64; 3]>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Where the circle of each strut begins in `rims`, and the length of `rims`.
    pub(super) rim_starts: Vec<u32>,
    pub(super) rims: Vec<u32>,
}

impl FilmMesh {
    /// How often the control mesh was refined.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Positions of the vertices. Those of the level before come first, and in the same order.
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.vertices
    }

    /// Unit normals outwards, one for each vertex. On the circles they are those of the struts.
    pub fn normals(&self) -> &[[f64; 3]] {
        &self.normals
    }

    /// Corners of the triangles. Those of triangle `t` of the level before are `4t` to `4t + 3`: one at each of its corners, and the one
    /// between.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Number of circles: one for each strut.
    pub fn rim_count(&self) -> usize {
        self.rim_starts.len().saturating_sub(1)
    }

    /// Vertices of the circle where a strut is cut, in order, counter-clockwise as seen along the strut towards the node. `strut` counts
    /// the ends of the node as they were given.
    ///
    /// # Panics
    ///
    /// If there is no such strut.
    pub fn rim(&self, strut: usize) -> &[u32] {
        &self.rims[self.rim_starts[strut] as usize..self.rim_starts[strut + 1] as usize]
    }

    /// Least and greatest z of the vertices; 0 and 0 of an empty mesh.
    pub fn z_bounds(&self) -> [f64; 2] {
        let of = |merge: fn(f64, f64) -> f64| self.vertices.iter().map(|vertex| vertex[2]).reduce(merge).unwrap_or(0.0);
        [of(f64::min), of(f64::max)]
    }

    /// Fills it from a surface in radii. `places` tells which circle of the surface each strut has.
    pub(super) fn fill(&mut self, surface: &Surface, level: Level, radius: f64, places: &[usize]) {
        self.level = level;
        self.vertices.clear();
        self.vertices.extend(surface.points.iter().map(|point| (*point * radius).to_array()));
        self.normals.clear();
        self.normals.extend(surface.normals.iter().map(DVec3::to_array));
        self.triangles.clear();
        self.triangles.extend(surface.triangles.iter().map(|triangle| triangle.corners));
        self.rim_starts.clear();
        self.rims.clear();
        for place in places {
            self.rim_starts.push(self.rims.len() as u32);
            let [from, to] = [*place, *place + 1].map(|at| surface.rim_starts[at] as usize);
            self.rims.extend(&surface.rim_vertices[from..to]);
        }
        self.rim_starts.push(self.rims.len() as u32);
    }
}
