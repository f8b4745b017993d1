//! OBJ.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::pack_bench::Bench;
use crate::skip::skipped;
use crate::stl::binary;
use crate::{BOX, SIDES, box_triangles, corner, cuboid, packed, said, volume_mm3};

/// The corners of a box.
pub(crate) fn vertices(low: [f32; 3], high: [f32; 3]) -> String {
    let mut text = String::new();
    for number in 0..8 {
        let [x, y, z] = corner(number, low, high).map(f64::from);
        writeln!(text, "v {x} {y} {z}").expect("a string");
    }
    text
}

/// Faces of triangles; the number of a corner is written by `write`.
fn faces(write: impl Fn(usize) -> String) -> String {
    box_triangles().map(|corners| format!("f {}\n", corners.map(&write).join(" "))).collect()
}

/// A box of triangles.
pub(crate) fn boxed() -> String {
    vertices(BOX.0, BOX.1) + &faces(|corner| (corner + 1).to_string())
}

#[test]
fn a_box_is_the_one_of_stl_however_it_is_written() {
    let bench = Bench::new();
    let (_, expected) = packed(&bench, &[bench.file("a.stl", &binary(b"", &cuboid(BOX.0, BOX.1)))]).expect("a box");
    let vertices = vertices(BOX.0, BOX.1);
    let quads: String =
        SIDES.iter().map(|side| format!("f {}\n", side.map(|corner| (corner + 1).to_string()).join(" "))).collect();
    let faces_of_one = faces(|corner| (corner + 1).to_string());
    let (first, second) = faces_of_one.split_at(faces_of_one.len() / 2);
    let cut = first.rfind('\n').expect("lines") + 1;
    let groups = format!("o one\ng a\nusemtl red\n{}o two\nusemtl blue\n{}{second}", &first[..cut], &first[cut..]);
    let colours: String = vertices.lines().take(3).map(|line| format!("{line} 0.5 0.5 1\n")).collect();
    let rest: String = vertices.lines().skip(3).map(|line| format!("{line} 1\n")).collect();
    let slashed = faces(|corner| format!("{}/9999/-9223372036854775808", corner + 1));
    let interleaved: String = box_triangles()
        .map(|corners| {
            let vertex = |number: usize| {
                let [x, y, z] = corner(number, BOX.0, BOX.1).map(f64::from);
                format!("v {x} {y} {z}\n")
            };
            corners.map(vertex).concat() + "f -3 -2 -1\n"
        })
        .collect();
    for (name, text) in [
        ("plain.obj", boxed()),
        ("interleaved.obj", interleaved),
        ("capitals.OBJ", boxed().replace('\n', "\r\n")),
        ("quads.obj", format!("{vertices}{quads}")),
        ("continued.obj", format!("{vertices}{quads}").replace("f 0", "f \\\n0").replace(" 4", " \\\r\n 4")),
        ("negative.obj", vertices.clone() + &faces(|corner| format!("-{}", 8 - corner))),
        ("groups.obj", format!("mtllib /nonexistent/a.mtl\nmtllib\n{vertices}{groups}")),
        ("colours.obj", format!("# a comment\n{colours}{rest}{faces_of_one}")),
        ("slashes.obj", format!("{vertices}vt 0 0\nvn 0 0 1\nvn a b c\n{slashed}p 1 2\nl 1 2 3\nf 1 2\nf 1\n")),
    ] {
        let (_, found) = packed(&bench, &[bench.file(name, text.as_bytes())]).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(found, expected, "{name}");
    }
    let latin = [b"# caf\xe9\nv\xe9rin\n", boxed().as_bytes()].concat();
    assert_eq!(packed(&bench, &[bench.file("latin.obj", &latin)]).expect("a box").1, expected);
}

#[test]
fn bad_obj_is_refused_with_file_line_and_remedy() {
    let bench = Bench::new();
    let whole = boxed();
    let vertices = vertices(BOX.0, BOX.1);
    let open: String = whole.lines().take(18).map(|line| format!("{line}\n")).collect();
    let reversed = vertices.clone() + &faces(|corner| (corner + 1).to_string()).replace("f ", "f 1 1 ");
    let changed = |from: &str, to: &str| whole.replacen(from, to, 1).into_bytes();
    for (name, bytes, expected) in [
        ("empty.obj", Vec::new(), "no faces"),
        ("points.obj", vertices.clone().into_bytes(), "no faces"),
        ("lines.obj", (vertices.clone() + "l 1 2 3\nf 1 2\n").into_bytes(), "no faces"),
        ("cut.obj", whole.as_bytes()[..whole.len() - 20].to_vec(), "open"),
        ("hole.obj", open.into_bytes(), "open"),
        ("fans.obj", reversed.into_bytes(), "encloses nothing"),
        ("range.obj", changed("f 1", "f 9"), "line 9: vertex 9; there are 8 vertices"),
        ("far_range.obj", changed("f 1", "f 9223372036854775807"), "line 9: vertex 9223372036854775807"),
        ("zero.obj", changed("f 1", "f 0"), "line 9: vertex 0; there are 8"),
        ("before.obj", changed("f 1", "f -9"), "line 9: vertex -9; there are 8"),
        ("huge.obj", changed("f 1", "f 99999999999999999999"), "line 9: `99999999999999999999` is no number"),
        ("word.obj", changed("f 1", "f one"), "line 9: `one` is no number"),
        ("nothing.obj", changed("f 1", "f //1"), "line 9: `//1` is no number"),
        ("vertex.obj", changed("v 1", "v one"), "line 1: position"),
        ("short.obj", changed("v 1 2", "v 1"), "line 1: position"),
        ("by_zero.obj", changed("v 1 2 0.10000000149011612", "v 1 2 3 0"), "line 1: position: its weight (w) is 0"),
        ("nan.obj", changed("v 1", "v nan"), "triangle 1: the point"),
        ("far.obj", changed("v 1", "v 1e300"), "triangle 1: the point"),
        (
            "line.obj",
            format!("{whole}# {}", "x".repeat(100_000)).into_bytes(),
            "line 21: a line of more than 65536 bytes",
        ),
        (
            "face.obj",
            format!("{whole}f {}", "1 ".repeat(50_000)).into_bytes(),
            "line 21: a line of more than 65536 bytes",
        ),
        ("garbage.obj", (0..=255).cycle().take(10_000).collect(), "no faces"),
        ("garbage_in_face.obj", [whole.as_bytes(), b"f \xff\xfe\x00 1 2\n"].concat(), "line 21: it is no text"),
    ] {
        let found = said(&bench, name, &bytes);
        assert!(found.contains(expected), "`{found}` does not say `{expected}`");
        assert!(found.chars().count() < 400, "{found}");
    }
}

#[test]
fn what_does_not_fit_memory_is_refused_while_it_is_read() {
    let mut bench = Bench::new();
    bench.options.memory_bytes = 1 << 20;
    let others = "v 1 2 3\n".repeat(50_000);
    let found = said(&bench, "large.obj", (vertices(BOX.0, BOX.1) + &others).as_bytes());
    assert!(found.contains("and --memory allows 1.0 MiB; give more"), "{found}");
}

/// Six times the volume that the faces enclose.
fn volume_times_six(text: &str) -> f64 {
    let words = |key: &'static str| {
        text.lines()
            .map(str::split_whitespace)
            .filter_map(move |mut words| (words.next() == Some(key)).then_some(words))
    };
    let points: Vec<[f64; 3]> = words("v")
        .map(|mut words| std::array::from_fn(|_| words.next().expect("a number").parse().expect("a number")))
        .collect();
    let point = |word: &str| points[word.split('/').next().expect("a word").parse::<usize>().expect("a number") - 1];
    let determinant = |[a, b, c]: [[f64; 3]; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    words("f")
        .map(|words| {
            let corners: Vec<_> = words.map(point).collect();
            corners[1..].windows(2).map(|pair| determinant([corners[0], pair[0], pair[1]])).sum::<f64>()
        })
        .sum()
}

#[test]
fn a_real_mesh_has_the_volume_of_its_text() {
    const SCALE: f64 = 10.0;
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let path = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from).join("spot.obj");
    let Ok(text) = std::fs::read_to_string(&path) else { return skipped(&format!("there is no {}", path.display())) };
    let mut bench = Bench::new();
    bench.options.scale = [SCALE; 3];
    let (report, triangles) = packed(&bench, &[path]).expect("it is closed");
    assert_eq!(report.header.bodies.len(), 1);
    assert!(triangles.len() > 1000, "{}", triangles.len());
    let expected = volume_times_six(&text) / 6.0 * SCALE.powi(3);
    let found = volume_mm3(&bench);
    assert!((found / expected - 1.0).abs() < 0.01, "{found} mm³; the text has {expected} mm³");
}
