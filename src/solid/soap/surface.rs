//! A triangle mesh that can be refined: it knows its edges, what lies beside them, and the circles that bound it. `control` makes the
//! first one, `subdivide` the others.

use glam::DVec3;

use super::unit_or;

/// Stands for the triangle that is not there, beside an edge of a circle.
pub(super) const NONE: u32 = u32::MAX;

/// An edge of the mesh.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub(super) ends: [u32; 2],
    /// The opposite corner of the triangle that runs along the edge from its first end to the second, and of the one that runs back.
    pub(super) opposite: [u32; 2],
}

impl Edge {
    pub(super) fn new(from: u32, to: u32) -> Self {
        Self { ends: [from, to], opposite: [NONE; 2] }
    }

    pub(super) fn is_rim(&self) -> bool {
        self.opposite.contains(&NONE)
    }
}

/// Three corners, counter-clockwise as seen from outside, and the edge from each to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triangle {
    pub(super) corners: [u32; 3],
    pub(super) sides: [u32; 3],
}

/// The mesh, in radii from the node.
#[derive(Debug, Default)]
pub(super) struct Surface {
    pub(super) points: Vec<DVec3>,
    /// Unit vectors outwards.
    pub(super) normals: Vec<DVec3>,
    pub(super) edges: Vec<Edge>,
    pub(super) triangles: Vec<Triangle>,
    /// The number of neighbours of each vertex of the control mesh; later ones have six. 0 on the circles, whose points stay.
    pub(super) valences: Vec<u32>,
    /// Where the circle of each strut begins in the lists below, and their length.
    pub(super) rim_starts: Vec<u32>,
    /// The circles' vertices, counter-clockwise as seen from outside.
    pub(super) rim_vertices: Vec<u32>,
    /// The edge from each of these to the next one.
    pub(super) rim_edges: Vec<u32>,
}

impl Surface {
    pub(super) fn clear(&mut self) {
        self.points.clear();
        self.normals.clear();
        self.edges.clear();
        self.triangles.clear();
        self.valences.clear();
        self.rim_starts.clear();
        self.rim_vertices.clear();
        self.rim_edges.clear();
    }

    /// Tells the edges what lies beside them.
    pub(super) fn join(&mut self) {
        for Triangle { corners, sides } in &self.triangles {
            for at in 0..3 {
                let edge = &mut self.edges[sides[at] as usize];
                let side = usize::from(edge.ends[0] != corners[at]);
                edge.opposite[side] = corners[(at + 2) % 3];
            }
        }
    }

    /// Counts the neighbours of the control mesh.
    pub(super) fn count_neighbours(&mut self) {
        self.valences.resize(self.points.len(), 0);
        for end in self.edges.iter().flat_map(|edge| edge.ends) {
            self.valences[end as usize] += 1;
        }
        self.rim_vertices.iter().for_each(|vertex| self.valences[*vertex as usize] = 0);
    }

    /// Sets the normals of all vertices: those of the triangles around them, weighted by area.
    pub(super) fn set_normals(&mut self) {
        self.normals.resize(self.points.len(), DVec3::ZERO);
        for Triangle { corners, .. } in &self.triangles {
            let [a, b, c] = corners.map(|corner| self.points[corner as usize]);
            let doubled_area = (b - a).cross(c - a);
            corners.iter().for_each(|corner| self.normals[*corner as usize] += doubled_area);
        }
        for (normal, point) in self.normals.iter_mut().zip(&self.points) {
            // Triangles that cancel have no normal; away from the node is as good as any.
            *normal = unit_or(*normal, unit_or(*point, DVec3::Z));
        }
    }
}
