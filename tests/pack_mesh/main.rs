//! Packing solids: STL, OBJ, PLY and meshes of 3MF.

mod any_bytes;
#[path = "../meshes/box_mesh.rs"]
mod box_mesh;
mod holes;
mod obj;
#[path = "../pack_bench/mod.rs"]
mod pack_bench;
mod ply;
#[path = "../properties/mod.rs"]
mod properties;
#[path = "../skip/mod.rs"]
mod skip;
#[path = "../slice_part/mod.rs"]
mod slice_part;
mod stl;
mod three_mf;

use std::path::PathBuf;
use std::sync::Arc;

use box_mesh::{SIDES, box_triangles, corner};
use layerd::buildfile::{BodyHeader, BuildFile, PackError, PackReport, Triangle, pack};
use layerd::slice::Volume;
use pack_bench::Bench;

/// A box, millimetres.
fn cuboid(low: [f32; 3], high: [f32; 3]) -> Vec<[[f32; 3]; 3]> {
    box_triangles().map(|triangle| triangle.map(|number| corner(number, low, high))).collect()
}

/// Packs sources and returns the triangles of what was written.
fn packed(bench: &Bench, inputs: &[PathBuf]) -> Result<(PackReport, Vec<Triangle>), PackError> {
    let output = bench.path("out.layerd");
    let report = pack(inputs, &output, &bench.options, &mut |_| {})?;
    let file = BuildFile::open(&output).expect("what pack writes is whole");
    file.verify().expect("it agrees with itself");
    let mut triangles = Vec::new();
    for (number, body) in file.header().bodies.iter().enumerate() {
        if matches!(body, BodyHeader::Surface(_)) {
            file.body_chunks(number).for_each(|chunk| file.read_triangles(chunk, &mut triangles).expect("is whole"));
        }
    }
    Ok((report, triangles))
}

fn said(bench: &Bench, name: &str, bytes: &[u8]) -> String {
    let found = packed(bench, &[bench.file(name, bytes)]).expect_err("it must be refused").to_string();
    assert!(found.contains(name), "`{found}` does not name the file");
    assert!(!bench.path("out.layerd").exists(), "nothing is left behind");
    found
}

/// Volume of what was packed, mm³.
fn volume_mm3(bench: &Bench) -> f64 {
    let file = Arc::new(BuildFile::open(&bench.path("out.layerd")).expect("it is whole"));
    Volume::sample(&file, 1).expect("it can be sliced").solid_mm3.value
}

const BOX: ([f32; 3], [f32; 3]) = ([1.0, 2.0, 0.1], [4.0, 4.0, 1.6]);

#[test]
fn an_unknown_kind_is_refused_with_the_kinds_that_pack_reads() {
    let found = said(&Bench::new(), "a.step", b"");
    for kind in [".3mf", ".stl", ".obj", ".ply", ".txt"] {
        assert!(found.contains(kind), "{found}");
    }
}
