//! STL, binary and text.

use sha2::{Digest, Sha256};
use std::fmt::Write as _;

use layerd::buildfile::BodyHeader;

use crate::pack_bench::Bench;
use crate::{BOX, cuboid, packed, said, volume_mm3};

pub(crate) fn binary(head: &[u8], triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
    let mut bytes = head.to_vec();
    bytes.resize(80, 0);
    bytes.extend((triangles.len() as u32).to_le_bytes());
    for triangle in triangles {
        bytes.extend([0; 12]);
        triangle.as_flattened().iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

fn text(triangles: &[[[f32; 3]; 3]]) -> String {
    let mut text = "solid part of a test\n".to_owned();
    for corners in triangles {
        text += " facet normal 0 0 1\n  outer loop\n";
        for [x, y, z] in corners {
            writeln!(text, "   vertex {x} {y} {z:e}").expect("a string");
        }
        text += "  endloop\n endfacet\n";
    }
    text + "endsolid\n"
}

#[test]
fn text_and_binary_hold_the_same_part() {
    let bench = Bench::new();
    let triangles = cuboid(BOX.0, BOX.1);
    let (report, expected) =
        packed(&bench, &[bench.file("a.stl", &binary(b"made by hand", &triangles))]).expect("it is a box");
    let BodyHeader::Surface(surface) = &report.header.bodies[0] else { panic!("{report:?}") };
    assert_eq!(surface.triangle_count, 12);
    assert_eq!((surface.bounds.min, surface.bounds.max), ([1000, 2000, 100], [4000, 4000, 1601]));
    assert!((report.header.bottom_um - 100.0).abs() < 1e-2, "{}", report.header.bottom_um);
    assert!((volume_mm3(&bench) - 9.0).abs() < 0.1, "{} mm³", volume_mm3(&bench));
    for (name, bytes) in [
        ("b.STL", text(&triangles).into_bytes()),
        // Some programs write such heads.
        ("c.stl", binary(b"solid made by a careless program", &triangles)),
    ] {
        let (report_here, found) = packed(&bench, &[bench.file(name, &bytes)]).expect("it is a box");
        assert_eq!(found, expected, "{name}");
        assert_ne!(report_here.header.source_digest, report.header.source_digest);
    }
}

#[test]
fn the_digest_is_that_of_the_file() {
    let bench = Bench::new();
    // What the reader passes over counts, too.
    for end in ["", "\n", "\n\nmore words\n"] {
        let text = text(&cuboid(BOX.0, BOX.1)) + end;
        let (report, _) = packed(&bench, &[bench.file("a.stl", text.as_bytes())]).expect("a box");
        assert_eq!(report.header.source_digest[..], Sha256::digest(&text)[..]);
    }
}

#[test]
fn options_and_several_sources_make_one_part() {
    let mut bench = Bench::new();
    let stl = bench.file("a.stl", &binary(b"", &cuboid(BOX.0, BOX.1)));
    // Two boxes that overlap by a third, one of them turned by a quarter.
    let other = bench.file("b.stl", &binary(b"", &cuboid([3.0, 2.0, 0.1], [6.0, 4.0, 1.6])));
    let (report, triangles) = packed(&bench, &[stl.clone(), other]).expect("two boxes");
    assert_eq!((report.header.bodies.len(), triangles.len()), (1, 24));
    assert!((volume_mm3(&bench) - 15.0).abs() < 0.15, "{} mm³", volume_mm3(&bench));
    bench.options.scale = [2.0, 1.0, 1.0];
    bench.options.rotate_deg = [0.0, 0.0, 90.0];
    let (report, _) = packed(&bench, &[stl]).expect("a box");
    assert_eq!(report.header.bounds.min, [-8000, 1000, 100], "turned, then scaled");
    assert!((volume_mm3(&bench) - 18.0).abs() < 0.2, "{} mm³", volume_mm3(&bench));
}

#[test]
fn bad_stl_is_refused_with_file_place_and_remedy() {
    let bench = Bench::new();
    let triangles = cuboid(BOX.0, BOX.1);
    let whole = binary(b"", &triangles);
    let words = text(&triangles);
    let mut reversed = triangles.clone();
    reversed.iter_mut().for_each(|triangle| triangle.swap(0, 1));
    let mut no_number = triangles.clone();
    no_number[7][2][1] = f32::NAN;
    let mut far = triangles.clone();
    far[2][0][2] = 1e30;
    let sheet: Vec<_> = triangles[..2].iter().copied().chain(reversed[..2].iter().copied()).collect();
    for (name, bytes, expected) in [
        ("empty.stl", Vec::new(), "too few"),
        ("cut.stl", whole[..600].to_vec(), "announces 12 triangles"),
        ("none.stl", binary(b"", &[]), "no triangles"),
        ("inside_out.stl", binary(b"", &reversed), "inside out: its volume is -9.000 mm³"),
        ("sheet.stl", binary(b"", &sheet), "encloses nothing"),
        ("nan.stl", binary(b"", &no_number), "triangle 8: the point"),
        ("far.stl", binary(b"", &far), "triangle 3: the point"),
        ("cut_text.stl", words.as_bytes()[..400].to_vec(), "triangle 4"),
        ("words.stl", words.replacen("vertex", "vortex", 1).into_bytes(), "vortex"),
        ("letter.stl", words.replacen("vertex 1", "vertex one", 1).into_bytes(), "invalid float"),
        ("line.stl", format!("solid {}", "x".repeat(100_000)).into_bytes(), "more than 65536 bytes"),
    ] {
        let found = said(&bench, name, &bytes);
        assert!(found.contains(expected), "`{found}` does not say `{expected}`");
    }
}

#[test]
fn more_triangles_than_memory_holds_are_sorted_on_the_disk() {
    let mut bench = Bench::new();
    let boxes: Vec<_> = (0..4000_u16)
        .flat_map(|number| {
            let [x, y, z] = [number % 20, number / 20 % 20, number / 400].map(|at| f32::from(at) * 2.0);
            cuboid([x, y, z], [x + 1.0, y + 1.0, z + 1.0])
        })
        .collect();
    let stl = bench.file("boxes.stl", &binary(b"", &boxes));
    let (_, expected) = packed(&bench, std::slice::from_ref(&stl)).expect("boxes");
    bench.options.memory_bytes = 1 << 20;
    let (report, found) = packed(&bench, &[stl]).expect("boxes");
    assert_eq!(found, expected);
    let bytes = std::fs::metadata(bench.path("out.layerd")).expect("it is there").len();
    assert!(bytes < 48_000 * 16, "{bytes} bytes for {:?}", report.header.bodies);
}
