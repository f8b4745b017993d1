//! PLY in its three encodings.

use std::fmt::Write as _;

use crate::pack_bench::Bench;
use crate::stl::binary;
use crate::{BOX, SIDES, box_triangles, corner, cuboid, packed, said};

/// How a body is encoded.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Way {
    Text,
    Little,
    Big,
}

pub(crate) const WAYS: [Way; 3] = [Way::Text, Way::Little, Way::Big];

fn head(way: Way, vertices: u64, faces: u64) -> String {
    let format = match way {
        Way::Text => "ascii",
        Way::Little => "binary_little_endian",
        Way::Big => "binary_big_endian",
    };
    format!(
        "ply\nformat {format} 1.0\ncomment made by hand\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
         property uchar red\nproperty float z\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
}

fn body(way: Way, points: &[[f32; 3]], faces: &[Vec<usize>]) -> Vec<u8> {
    let float = |value: f32| if matches!(way, Way::Big) { value.to_be_bytes() } else { value.to_le_bytes() };
    let int = |value: usize| {
        let value = value as i32;
        if matches!(way, Way::Big) { value.to_be_bytes() } else { value.to_le_bytes() }
    };
    let mut bytes = Vec::new();
    let mut text = String::new();
    for [x, y, z] in points {
        writeln!(text, "{x} {y} 255 {z}").expect("a string");
        bytes.extend([float(*x), float(*y)].concat());
        bytes.push(255);
        bytes.extend(float(*z));
    }
    for face in faces {
        let words: Vec<_> =
            std::iter::once(face.len()).chain(face.iter().copied()).map(|word| word.to_string()).collect();
        writeln!(text, "{}", words.join(" ")).expect("a string");
        bytes.push(face.len() as u8);
        face.iter().for_each(|corner| bytes.extend(int(*corner)));
    }
    if matches!(way, Way::Text) { text.into_bytes() } else { bytes }
}

/// Faces before vertices.
const ORDER: &str = "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_index\nelement vertex 1\nproperty int x\n\
                     end_header\n1 0\n0\n";

fn points() -> Vec<[f32; 3]> {
    (0..8).map(|number| corner(number, BOX.0, BOX.1)).collect()
}

fn faces() -> Vec<Vec<usize>> {
    box_triangles().map(|corners| corners.to_vec()).collect()
}

fn file(way: Way, points: &[[f32; 3]], faces: &[Vec<usize>]) -> Vec<u8> {
    [head(way, points.len() as u64, faces.len() as u64).into_bytes(), body(way, points, faces)].concat()
}

/// A box of triangles.
pub(crate) fn boxed(way: Way) -> Vec<u8> {
    file(way, &points(), &faces())
}

#[test]
fn a_box_is_the_one_of_stl_in_each_encoding() {
    let bench = Bench::new();
    let (_, expected) = packed(&bench, &[bench.file("a.stl", &binary(b"", &cuboid(BOX.0, BOX.1)))]).expect("a box");
    let quads: Vec<_> = SIDES.iter().map(|side| side.to_vec()).collect();
    for way in WAYS {
        let lines = [quads.clone(), vec![vec![], vec![1], vec![1, 2]]].concat();
        for (name, bytes) in [
            ("a.ply", boxed(way)),
            ("quads.PLY", file(way, &points(), &quads)),
            ("lines.ply", file(way, &points(), &lines)),
        ] {
            let (_, found) =
                packed(&bench, &[bench.file(name, &bytes)]).unwrap_or_else(|error| panic!("{way:?}: {error}"));
            assert_eq!(found, expected, "{name}, {way:?}");
        }
        // Another name, other elements around, and bytes after the end.
        let head = head(way, 8, 12)
            .replace("vertex_indices", "vertex_index")
            .replace("element vertex", "element origin 1\nproperty uchar a\nelement vertex");
        let origin: &[u8] = if matches!(way, Way::Text) { b"7\n" } else { b"7" };
        let bytes = [head.as_bytes(), origin, &body(way, &points(), &faces()), b"more"].concat();
        let (_, found) =
            packed(&bench, &[bench.file("b.ply", &bytes)]).unwrap_or_else(|error| panic!("{way:?}: {error}"));
        assert_eq!(found, expected, "{way:?}");
    }
}

#[test]
fn bad_ply_is_refused_with_file_place_and_remedy() {
    let bench = Bench::new();
    for way in WAYS {
        let whole = boxed(way);
        let head_only = |vertices, faces| head(way, vertices, faces).into_bytes();
        let with_head = |from: &str, to: &str| {
            [head(way, 8, 12).replacen(from, to, 1).into_bytes(), body(way, &points(), &faces())].concat()
        };
        let mut no_number = points();
        no_number[0][1] = f32::NAN;
        let mut far = points();
        far[0][2] = 1e30;
        let mut wild = faces();
        wild[4][1] = 8;
        let mut reversed = faces();
        reversed.iter_mut().for_each(|corners| corners.swap(0, 1));
        let in_text = matches!(way, Way::Text);
        for (name, bytes, expected) in [
            ("empty.ply", Vec::new(), "end of file"),
            ("cut_head.ply", head(way, 8, 12).split_once("element").expect("it is there").0.into(), "end of file"),
            ("cut_line.ply", whole[..70].to_vec(), "Line"),
            ("no_body.ply", head_only(8, 12), "is it cut short?"),
            ("cut.ply", whole[..whole.len() - 40].to_vec(), if in_text { "face 8: line 27" } else { "face 9: " }),
            ("huge.ply", head_only(4_000_000_000, 12), "is it cut short?"),
            ("huger.ply", head_only(u64::MAX, u64::MAX), "is it cut short?"),
            ("huge_faces.ply", with_head("face 12", "face 4000000000"), "is it cut short?"),
            ("too_large.ply", with_head("face 12", "face 99999999999999999999"), "Invalid element"),
            (
                "cloud.ply",
                with_head("element face 12\nproperty list uchar int vertex_indices\n", ""),
                "cloud of points",
            ),
            ("no_faces.ply", head_only(0, 0), "no vertices"),
            ("bare.ply", with_head("element face", "element bare 4000000000\nelement face"), "without properties"),
            ("order.ply", ORDER.into(), "before its vertices"),
            ("flat.ply", with_head("float z", "float w"), "no number `z`"),
            ("reals.ply", with_head("uchar int vertex", "uchar float vertex"), "no list `vertex_indices`"),
            ("names.ply", with_head("vertex_indices", "corners"), "no list `vertex_indices`"),
            ("format.ply", with_head("format", "fromat"), "Line 2: Couldn't parse line. String: 'fromat"),
            (
                "nan.ply",
                file(way, &no_number, &faces()),
                if in_text { "vertex 1: line 12" } else { "face 1: the point" },
            ),
            ("far.ply", file(way, &far, &faces()), "face 1: the point"),
            ("range.ply", file(way, &points(), &wild), "face 5: vertex 8; there are 8"),
            ("open.ply", file(way, &points(), &faces()[2..]), "open"),
            ("inside_out.ply", file(way, &points(), &reversed), "inside out"),
            ("line.ply", format!("ply\ncomment {}", "x".repeat(100_000)).into_bytes(), "end_header"),
            ("garbage.ply", (0..=255).cycle().take(10_000).collect(), "file.ply"),
        ] {
            let found = said(&bench, name, &bytes);
            assert!(found.contains(expected) || name == "garbage.ply", "{way:?}: `{found}` does not say `{expected}`");
            assert!(found.chars().count() < 500, "{found}");
        }
    }
}

#[test]
fn long_elements_and_lists_that_lie_are_refused() {
    let bench = Bench::new();
    let body = body(Way::Text, &points(), &faces());
    let long = [head(Way::Text, 8, 12).as_bytes(), &body[..body.len() - 8], " ".repeat(100_000).as_bytes()].concat();
    let found = said(&bench, "line.ply", &long);
    assert!(found.contains("line 31: a line of more than 65536 bytes"), "{found}");
    let head = head(Way::Little, 8, 1).replace("list uchar int", "list uint int");
    let points = self::body(Way::Little, &points(), &[]);
    for (name, count, rest, expected) in [
        ("lie.ply", u32::MAX, 100, "face 1: "),
        ("long.ply", 50_000, 400_000, "face 1: more than 65536 bytes"),
        ("longer.ply", u32::MAX, 400_000, "face 1: more than 65536 bytes"),
    ] {
        let bytes = [head.as_bytes(), &points, &count.to_le_bytes(), &vec![0; rest]].concat();
        let found = said(&bench, name, &bytes);
        assert!(found.contains(expected), "`{found}` does not say `{expected}`");
    }
}

#[test]
fn vertices_that_do_not_fit_memory_are_refused_before_they_are_read() {
    let mut bench = Bench::new();
    bench.options.memory_bytes = 1 << 20;
    let many = vec![[0.0; 3]; 50_000];
    let found = said(&bench, "large.ply", &file(Way::Little, &many, &faces()));
    assert!(found.contains("50000 vertices take 1.1 MiB, and --memory allows 1.0 MiB"), "{found}");
}
