//! Build files with relief: their size, and what damage does to them.

use layerd::buildfile::{BodyHeader, BuildFile, pack};
use layerd::layer::Depth;
use layerd::pipeline::{PartError, Placed, Resolution};

use crate::objects::cuboid;
use crate::pack_bench::Bench;
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

#[test]
fn a_header_that_states_huge_maps_is_refused_before_any_is_decoded() {
    let png = noisy();
    let part = Part::new(&cuboid([1.0; 3]), &Recipe { map: Some(&png), height_mm: 0.1, ..PLAIN });
    let good = std::fs::read(part.file.path()).expect("it is there");
    let size: Vec<u8> = [128_u32, 128].iter().flat_map(|count| count.to_le_bytes()).collect();
    let at = good.windows(8).position(|bytes| bytes == size).expect("the header states the size of its map");
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("hostile.layerd");
    let refused = |size: [u32; 2], png_bytes: u32| {
        let mut bytes = good.clone();
        size.iter().zip([0, 4]).for_each(|(count, place)| write_u32(&mut bytes, at + place, *count));
        // Behind the size: two kinds of tiles, a flag, the length of a texel and a level.
        let length = at + 8 + 8 + 1 + 8 + 1;
        if png_bytes > 0 {
            write_u32(&mut bytes, length, png_bytes);
        }
        let header_bytes = u32::from_le_bytes(bytes[12..16].try_into().expect("4 bytes")) as usize;
        let crc = crc32fast::hash(&bytes[20..20 + header_bytes]);
        write_u32(&mut bytes, 16, crc);
        std::fs::write(&path, bytes).expect("can be written");
        BuildFile::open(&path).and_then(|file| file.verify()).expect_err("a lie").to_string()
    };
    for (size, png_bytes, told) in [
        ([32_768, 32_768], 0, "a map of 32768 × 32768 texels: it may have 67108864, because it is decoded as a whole"),
        ([u32::MAX, u32::MAX], 0, "is out of range"),
        ([8192, 8193], 0, "it may have 67108864"),
        ([8192, 8192], 0, "it is no grey map of 8192 × 8192 texels"),
        ([128, 128], 1 << 31, "a PNG of 2147483648 bytes for a map of 128 × 128 texels is too long"),
    ] {
        let error = refused(size, png_bytes);
        assert!(error.contains("hostile.layerd") && error.contains(told), "`{error}` does not say `{told}`");
    }
}

fn write_u32(bytes: &mut [u8], at: usize, value: u32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}

#[test]
fn the_check_of_a_map_is_part_of_the_memory_that_a_job_needs() {
    // A print with coarse pixels halves the map; the check before it does not.
    let png = map([2048, 2048], |[u, v]| (u + v) / 2.0);
    let part = Part::new(&cuboid([3.0; 3]), &Recipe { map: Some(&png), height_mm: 0.1, ..PLAIN });
    let plan = part.plan(Depth::Bit);
    let resolution =
        Resolution { raster: plan.raster, depth: Depth::Bit, layer_height_um: plan.layer_height_um, scan: None };
    let placed = || Placed::open(part.file.path(), &resolution).expect("it fits the machine");
    let need_bytes = placed().memory(1, 0).need_bytes();
    assert!((14 << 20..20 << 20).contains(&need_bytes), "{need_bytes} bytes for a map of 4 Mi texels");
    let refused = placed().fit(1, need_bytes - 1).expect_err("it is one byte too little");
    assert!(matches!(refused, PartError::Memory { need_bytes: told, .. } if told == need_bytes), "{refused}");
    let fits = placed().fit(1, need_bytes).expect("it is just enough");
    fits.verify(Some(need_bytes)).expect("it is whole");
    fits.verify(None).expect("nothing is decoded");
    fits.verify_reach(need_bytes).expect("it is whole");
    let error = fits.verify(Some(need_bytes / 2)).expect_err("it is too little").to_string();
    assert!(error.contains("the check of a height map takes"), "{error}");
}

#[test]
fn several_maps_are_checked_one_after_the_other() {
    // Each material has a map of its own, so that the faces of a box are displaced by six of them.
    let bench = Bench::new();
    let text = cuboid([1.0; 3]).obj();
    let (mut obj, mut library, mut faces) = ("mtllib in.mtl\n".to_owned(), String::new(), 0);
    for line in text.lines() {
        if line.starts_with('f') {
            if faces % 2 == 0 {
                let number = faces / 2;
                obj += &format!("usemtl m{number}\n");
                library += &format!("newmtl m{number}\ndisp -bm 0.{number} map{number}.png\n");
                bench.file(&format!("map{number}.png"), &map([16 + number, 8], |[u, _]| u));
            }
            faces += 1;
        }
        obj = obj + line + "\n";
    }
    bench.file("in.mtl", library.as_bytes());
    let output = bench.path("out.layerd");
    let source = bench.file("in.obj", obj.as_bytes());
    let report = pack(&[source], &output, &bench.options, &mut |_| {}).unwrap_or_else(|error| panic!("{error}"));
    let BodyHeader::Relief(relief) = &report.header.bodies[0] else { panic!("it has relief") };
    assert_eq!(relief.maps.len(), 6);
    let file = BuildFile::open(&output).expect("what pack writes is whole");
    file.verify().expect("it agrees with itself");
    // Its bounds and its bottom, with true checksums.
    let good = std::fs::read(&output).expect("it is there");
    for (name, at) in [("bounds", 28), ("bottom", 52)] {
        let mut bytes = good.clone();
        bytes[at] ^= 1;
        let header_bytes = u32::from_le_bytes(bytes[12..16].try_into().expect("4 bytes")) as usize;
        let crc = crc32fast::hash(&bytes[20..20 + header_bytes]);
        write_u32(&mut bytes, 16, crc);
        std::fs::write(&output, bytes).expect("can be written");
        BuildFile::open(&output).and_then(|file| file.verify()).expect_err(name);
    }
}
