//! Build files with relief: their size, and what damage does to them.

use layerd::layer::Depth;

use crate::objects::cuboid;
use crate::slice_part::drawn;
use crate::{PLAIN, Part, Recipe, map};

fn noisy() -> Vec<u8> {
    map([128, 128], |[u, v]| 0.5 + 0.4 * (40.0 * u).sin() * (30.0 * v).cos())
}

#[test]
fn a_mesh_of_12_triangles_takes_little_more_than_its_map() {
    let png = noisy();
    let part = Part::new(&cuboid([2.0; 3]), &Recipe { map: Some(&png), height_mm: 0.2, ..PLAIN });
    let bytes = part.file.file_bytes();
    assert!(bytes as f64 <= 1.2 * png.len() as f64, "{bytes} bytes for a map of {}", png.len());
}

#[test]
fn damage_is_found_and_never_crashes() {
    let png = noisy();
    let part = Part::new(&cuboid([1.0; 3]), &Recipe { map: Some(&png), height_mm: 0.1, is_curved: true, ..PLAIN });
    let bytes = std::fs::read(part.file.path()).expect("it is there");
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("damaged.layerd");
    let plan = part.plan(Depth::Bit);
    let check = |bytes: &[u8]| {
        std::fs::write(&path, bytes).expect("can be written");
        drawn(&path, &plan)
    };
    check(&bytes).expect("it is whole");
    let step = bytes.len() / 300;
    for at in (0..bytes.len()).step_by(step) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x41;
        check(&damaged).expect_err("a changed byte is found");
        check(&bytes[..at]).expect_err("a file that is cut short is found");
    }
}
