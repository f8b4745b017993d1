//! What cannot be packed is refused with its place and a remedy.

use crate::objects::{ball, cuboid};
use crate::pack_bench::Bench;
use crate::{PLAIN, Recipe, map, packed};

fn said(text: &str, recipe: &Recipe<'_>) -> String {
    let mut bench = Bench::new();
    let error = packed(&mut bench, text, recipe).expect_err("it must be refused").to_string();
    assert!(!bench.path("out.layerd").exists(), "nothing is left behind");
    error
}

#[test]
fn maps_that_are_none_are_refused() {
    let whole = map([64, 64], |[u, v]| (u * v).fract());
    let cube = cuboid([1.0; 3]).obj();
    let refused = |bytes: &[u8]| said(&cube, &Recipe { map: Some(bytes), ..PLAIN });
    for (bytes, expected) in [
        (&b""[..], "it is not a PNG"),
        (&b"P5 1 1 255 x"[..], "it is not a PNG"),
        (&whole[..whole.len() / 2], "give a whole PNG"),
        (&huge([70_000, 8])[..], "a side has at most 32768"),
        (&huge([32_768, 32_768])[..], "a height map has at most 67108864 (8192 × 8192): scale it down"),
        (&huge([8192, 8193])[..], "a height map has at most 67108864 (8192 × 8192): scale it down"),
        (&huge([8192, 8192])[..], "and --memory allows"),
    ] {
        let error = refused(bytes);
        assert!(error.contains("map.png") && error.contains(expected), "`{error}` does not say `{expected}`");
    }
}

/// The head of a PNG of this size, and no texels.
fn huge(size: [u32; 2]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
    encoder.set_color(png::ColorType::Grayscale);
    drop(encoder.write_header().expect("a head"));
    // An empty chunk of texels in front of the end.
    let end = bytes.len() - 12;
    bytes.splice(end..end, *b"\0\0\0\0IDAT\x35\xaf\x06\x1e");
    bytes
}

#[test]
fn a_missing_map_is_named() {
    let mut bench = Bench::new();
    let source = bench.file("in.obj", cuboid([1.0; 3]).obj().as_bytes());
    let map = bench.path("absent.png");
    bench.options.relief.map =
        Some(layerd::buildfile::DisplacementOptions { map, tile: layerd::buildfile::Tile::Wrap });
    bench.options.relief.height_mm = Some(1.0);
    let refused = layerd::buildfile::pack(&[source], &bench.path("out.layerd"), &bench.options, &mut |_| {});
    let error = refused.expect_err("it is not there").to_string();
    assert!(error.contains("absent.png"), "{error}");
}

#[test]
fn what_is_read_is_not_overwritten() {
    let bench = Bench::new();
    let white = bench.file("white.layerd", &map([4, 4], |_| 1.0));
    let text = format!("mtllib library.layerd\nusemtl rough\n{}", cuboid([1.0; 3]).obj());
    let source = bench.file("in.obj", text.as_bytes());
    let library = bench.file("library.layerd", b"newmtl rough\ndisp white.layerd\n");
    for output in [&white, &library] {
        let before = std::fs::read(output).expect("is there");
        let refused = layerd::buildfile::pack(std::slice::from_ref(&source), output, &bench.options, &mut |_| {});
        let error = refused.expect_err("it would be lost").to_string();
        assert!(error.contains(&output.display().to_string()) && error.contains("both source and output"), "{error}");
        assert!(before == std::fs::read(output).expect("is there"));
    }
}

#[test]
fn maps_and_libraries_that_are_pipes_are_refused_instead_of_waited_for() {
    let mut bench = Bench::new();
    let pipe = |name: &str| {
        let path = bench.path(name);
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.expect("mkfifo is there").success());
        path
    };
    let (png, library) = (pipe("pipe.png"), pipe("pipe.mtl"));
    let cube = cuboid([1.0; 3]).obj();
    let whole = bench.file("whole.obj", cube.as_bytes());
    let with_library = bench.file("with.obj", format!("mtllib pipe.mtl\nusemtl rough\n{cube}").as_bytes());
    for (source, map, named) in [(&whole, Some(&png), &png), (&with_library, None, &library)] {
        bench.options.relief.map = map.map(|map| layerd::buildfile::DisplacementOptions {
            map: map.clone(),
            tile: layerd::buildfile::Tile::Wrap,
        });
        bench.options.relief.height_mm = map.map(|_| 1.0);
        let refused = layerd::buildfile::pack(
            std::slice::from_ref(source),
            &bench.path("out.layerd"),
            &bench.options,
            &mut |_| {},
        );
        let error = refused.expect_err("it is a pipe").to_string();
        assert!(error.contains(&named.display().to_string()) && error.contains("no regular file"), "{error}");
    }
}

#[test]
fn texture_coordinates_have_to_be_there() {
    let white = map([4, 4], |_| 1.0);
    let recipe = Recipe { map: Some(&white), ..PLAIN };
    let bare =
        cuboid([1.0; 3]).obj().lines().filter(|line| !line.starts_with("vt")).fold(String::new(), |text, line| {
            let line: String = if line.starts_with('f') {
                line.split(' ').map(|word| word.split('/').next().unwrap_or_default().to_owned() + " ").collect()
            } else {
                line.into()
            };
            text + &line + "\n"
        });
    let error = said(&bare, &recipe);
    assert!(error.contains("triangle 1") && error.contains("no texture coordinates"), "{error}");
    for (from, to, expected) in [
        ("vt 0 0", "vt 0 one", "texture coordinates 0.0, NaN"),
        ("vt 0 0", "vt 1e9 0", "allowed are -500 to 500"),
        ("/1 2", "/99999 2", "texture coordinate 99999; there are 36 texture coordinates"),
    ] {
        let error = said(&cuboid([1.0; 3]).obj().replacen(from, to, 1), &recipe);
        assert!(error.contains("line ") && error.contains(expected), "`{error}` does not say `{expected}`");
    }
    let error = said(&ball(1.0, 4, 8).obj().replacen("vn 0", "vn zero", 1), &recipe);
    assert!(error.contains("a normal (vn) is no three numbers"), "{error}");
}

#[test]
fn options_out_of_range_are_refused() {
    let cube = cuboid([1.0; 3]).obj();
    let white = map([4, 4], |_| 1.0);
    for (recipe, expected) in [
        (Recipe { map: Some(&white), height_mm: f64::NAN, ..PLAIN }, "--height NaN: allowed is -1000 to 1000 mm"),
        (Recipe { map: Some(&white), offset_mm: 1e4, ..PLAIN }, "--offset 10000: allowed is -1000 to 1000 mm"),
        (Recipe { shell_mm: Some(0.0), ..PLAIN }, "--shell 0: allowed is 0.001 to 1000 mm"),
    ] {
        let error = said(&cube, &recipe);
        assert!(error.contains(expected), "`{error}` does not say `{expected}`");
    }
}
