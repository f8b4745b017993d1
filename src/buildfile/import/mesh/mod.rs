//! Meshes of triangles: STL. Each reader hands its triangles to the [`Collector`]. `tests/pack_mesh.rs` has examples.

mod stl;

pub(super) use stl::import as import_stl;
