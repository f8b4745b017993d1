//! Soap-film nodes: the smooth surface between the struts that meet at a node of a lattice (Luo & Zou 2025, "Soap film-inspired
//! subdivisional lattice structure construction", §3). `tests/nodes/` tests them and `benches/nodes.rs` measures them.
//!
//! Each strut is cut where it no longer meets its neighbours (`cut`, their Eq. 3 to 5). A Voronoi diagram of the struts' directions
//! (`voronoi`) becomes a film near the intersection of the struts (`film`), and `control` joins the film to the circles where the struts
//! were cut. `fairing` smooths this control mesh (§3.3.2), and `subdivide` refines it (their Eq. 6 to 11). The struts themselves remain
//! cylinders. `level` says how far a level is from the limit.
//!
//! A mesh depends on directions, radius, λ and level alone, not on the place of the node or the order of its struts: equal input gives
//! equal bits. All of it is computed with + − × ÷ and √, so that every machine computes the same.
//!
//! ```
//! use layerd::solid::soap::{FilmBuilder, FilmMesh, Node, StrutEnd};
//! let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
//! let directions = [x, y, z, x.map(|x| -x), y.map(|y| -y), z.map(|z| -z)];
//! let ends = directions.map(|direction| StrutEnd { direction, length: 5000.0 });
//! let node = Node { ends: &ends, radius: 400.0, lambda: Node::USUAL_LAMBDA };
//! let mut builder = FilmBuilder::new();
//! let outline = builder.outline(&node).expect("the struts are long enough");
//! // Struts at right angles are cut at 1.3 radii.
//! assert!(outline.cuts.iter().all(|cut| (cut - 1.3 * 400.0).abs() < 1e-9));
//! let mut mesh = FilmMesh::default();
//! builder.mesh(&node, outline.level(12.5), &mut mesh).expect("as before");
//! assert!(mesh.vertices().iter().all(|vertex| vertex[2] > outline.bounds[0][2]));
//! ```

mod cap;
mod control;
mod cut;
mod fairing;
mod film;
mod level;
mod mesh;
mod node;
mod subdivide;
mod surface;
mod voronoi;

pub use level::Level;
pub use mesh::FilmMesh;
pub use node::{FilmBuilder, NoFilm, Node, Outline, StrutEnd};

use glam::DVec3;

/// The unit vector of `vector`, or `otherwise` where it has no direction.
fn unit_or(vector: DVec3, otherwise: DVec3) -> DVec3 {
    let length = vector.length();
    // The sum of unit vectors that cancel is about 1e-16.
    if length > 1e-12 { vector / length } else { otherwise }
}

/// The part of `vector` that is perpendicular to the unit vector `axis`.
fn across(vector: DVec3, axis: DVec3) -> DVec3 {
    vector - axis * vector.dot(axis)
}
