//! `--size`, `--scale`, `--rotate` and `--at` mean the same for lattices, flat solids and solids with relief.

mod pack_bench;

use std::fmt::Write as _;
use std::path::PathBuf;

use layerd::buildfile::{Bounds, DisplacementOptions, PackError, PackReport, Placement, Tile, pack};
use pack_bench::Bench;

/// A box of 10 × 20 × 40 mm with texture coordinates, as OBJ.
fn solid() -> String {
    let mut text = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n".to_owned();
    for corner in 0..8 {
        let [x, y, z] = [10, 20, 40].map(f64::from);
        let at = |axis: u32, length: f64| if corner >> axis & 1 == 0 { 3.0 } else { 3.0 + length };
        writeln!(text, "v {} {} {}", at(0, x), at(1, y), at(2, z)).expect("a string");
    }
    for face in [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]] {
        let corners = face.iter().zip(1..).map(|(corner, texture)| format!(" {corner}/{texture}"));
        text = text + "f" + &corners.collect::<String>() + "\n";
    }
    text
}

/// A strut along z, 36 mm long with a radius of 2 mm: with its ends it is 40 mm long.
const STRUT: &str = "1 2\n3 3 3 3 3 39\n";

fn packed(bench: &Bench, sources: &[PathBuf]) -> Result<PackReport, PackError> {
    pack(sources, &bench.path("out.layerd"), &bench.options, &mut |_| {})
}

fn sources(bench: &Bench) -> [PathBuf; 2] {
    [bench.file("solid.obj", solid().as_bytes()), bench.file("strut.txt", STRUT.as_bytes())]
}

fn edges_mm(Bounds { min, max }: Bounds) -> [f64; 3] {
    [0, 1, 2].map(|axis| f64::from(max[axis] - min[axis]) / 1000.0)
}

#[test]
fn a_size_is_that_of_the_longest_edge_whatever_the_part_is_made_of() {
    for relief in [false, true] {
        let mut bench = Bench::new();
        let [solid, strut] = sources(&bench);
        if relief {
            // Displaced by 1 mm at most, which is not scaled and does not count.
            let map = bench.file("map.png", &white());
            bench.options.relief.map = Some(DisplacementOptions { map, tile: Tile::Wrap });
            bench.options.relief.height_mm = Some(1.0);
        }
        for (size_mm, rotate_deg) in [(60.0, [0.0; 3]), (0.5, [90.0, 0.0, 0.0]), (123.4, [0.0, 90.0, 0.0])] {
            bench.options.size_mm = Some(size_mm);
            bench.options.rotate_deg = rotate_deg;
            // With relief, what is displaced of both together does not stick out on both sides.
            let both = if relief { vec![solid.clone()] } else { vec![solid.clone(), strut.clone()] };
            for sources in [vec![strut.clone()], vec![solid.clone()], both] {
                let report = packed(&bench, &sources).unwrap_or_else(|error| panic!("{error}"));
                let longest = edges_mm(report.header.bounds).into_iter().fold(0.0, f64::max);
                let displaced_mm = if relief && sources[0] == solid { 2.0 } else { 0.0 };
                assert!((longest - size_mm - displaced_mm).abs() < 0.006, "{longest} mm: {sources:?}, {size_mm}");
                let note = format!(", so that its longest edge has {size_mm} mm");
                assert!(
                    report.notes[0].starts_with("scaled by ") && report.notes[0].ends_with(&note),
                    "{:?}",
                    report.notes
                );
            }
        }
    }
}

/// A white picture.
fn white() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 2, 2);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header().expect("a head").write_image_data(&[255; 4]).expect("texels");
    bytes
}

#[test]
fn a_source_of_a_few_quanta_gets_its_size_all_the_same() {
    let mut bench = Bench::new();
    let solid = sources(&bench)[0].clone();
    bench.options.scale = [1.0; 3];
    bench.options.size_mm = Some(60.0);
    // 40.3 µm high, in a file of metres.
    let small = std::fs::read_to_string(&solid).expect("it is there").lines().fold(String::new(), |text, line| {
        let moved = |number: &str| number.parse::<f64>().map_or(number.to_owned(), |at| (at * 1.0075e-3).to_string());
        let line =
            if line.starts_with("v ") { line.split(' ').map(moved).collect::<Vec<_>>().join(" ") } else { line.into() };
        text + &line + "\n"
    });
    let report = packed(&bench, &[bench.file("small.obj", small.as_bytes())]).unwrap_or_else(|error| panic!("{error}"));
    let [x, y, z] = edges_mm(report.header.bounds);
    assert!((x - 15.0).abs() < 0.006 && (y - 30.0).abs() < 0.006 && (z - 60.0).abs() < 0.006, "{x}, {y}, {z} mm");
}

#[test]
fn a_size_is_the_same_as_the_scale_that_it_takes() {
    let mut bench = Bench::new();
    let [solid, strut] = sources(&bench);
    for sources in [[strut], [solid]] {
        bench.options.size_mm = Some(100.0);
        let by_size = packed(&bench, &sources).expect("can be packed").header;
        bench.options.size_mm = None;
        bench.options.scale = [2.5; 3];
        let by_scale = packed(&bench, &sources).expect("can be packed").header;
        bench.options.scale = [1.0; 3];
        assert_eq!((by_size.bounds, by_size.bodies), (by_scale.bounds, by_scale.bodies));
    }
}

#[test]
fn places_and_factors_apply_to_solids_as_to_lattices() {
    let mut bench = Bench::new();
    let [solid, strut] = sources(&bench);
    bench.options.placement = Placement::At { x_mm: 12.0, y_mm: 34.0 };
    bench.options.scale = [1.001, 1.002, 1.003];
    for curved in [false, true] {
        bench.options.relief.is_curved = curved;
        for (source, edges) in [(&strut, [4.0, 4.0, 40.0]), (&solid, [10.0, 20.0, 40.0])] {
            let header = packed(&bench, std::slice::from_ref(source)).expect("can be packed").header;
            assert_eq!(header.placement, Placement::At { x_mm: 12.0, y_mm: 34.0 });
            let found = edges_mm(header.bounds);
            for axis in 0..3 {
                let expected = edges[axis] * bench.options.scale[axis];
                assert!((found[axis] - expected).abs() < 0.01, "{found:?}, {expected} along {axis}");
            }
        }
    }
}

#[test]
fn sizes_that_cannot_be_are_refused() {
    let mut bench = Bench::new();
    let [solid, _] = sources(&bench);
    for size_mm in [0.0, -3.0, f64::NAN, 1e7] {
        bench.options.size_mm = Some(size_mm);
        let error = packed(&bench, std::slice::from_ref(&solid)).expect_err("it is no size").to_string();
        assert!(error.contains("--size") && error.contains("0.001 to 1000000 mm"), "{error}");
    }
    // Its radius vanishes before it is scaled.
    bench.options.size_mm = Some(40.0);
    let metres = bench.file("metres.txt", b"1 0.0000001\n0 0 0 0 0 0.04\n");
    let error = packed(&bench, &[metres]).expect_err("less than a quantum").to_string();
    assert!(error.contains("metres.txt:2: a radius of") && error.contains("give --scale instead"), "{error}");
    assert!(!bench.path("out.layerd").exists());
}
