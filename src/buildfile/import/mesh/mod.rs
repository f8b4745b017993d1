//! Meshes of triangles: STL, OBJ and PLY. Each reader hands its triangles to the [`Collector`]. `tests/pack_mesh` has examples.

mod mtl;
mod obj;
mod obj_lines;
mod ply;
mod ply_head;
mod source;
mod stl;

pub(super) use obj::import as import_obj;
pub(super) use ply::import as import_ply;
pub(super) use stl::import as import_stl;
