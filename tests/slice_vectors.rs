//! `layerctl slice` for a machine with a laser, as an operator runs it: what it writes, and what it refuses.

#![allow(clippy::unwrap_used, reason = "a test may fail by panicking, helpers included")]

mod support;

use std::path::Path;

use support::layerctl;
use tempfile::TempDir;

/// Field of the shipped simulated machine, micrometres; a part lies in its middle.
const MIDDLE_UM: f64 = 60_000.0;
const RADIUS_UM: f64 = 1000.0;
const BEAM_UM: f64 = 60.0;

fn done(arguments: &[&str]) -> String {
    let output = layerctl(Path::new("."), arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// A directory with a post of 1 mm radius and 3 mm height.
fn post() -> (TempDir, String) {
    let directory = tempfile::tempdir().unwrap();
    let [source, part] = ["post.txt", "post.layerd"].map(|name| directory.path().join(name));
    std::fs::write(&source, "1 1.0\n0 0 0 0 0 3\n").unwrap();
    let part = part.to_str().unwrap().to_owned();
    done(&["pack", source.to_str().unwrap(), "--joint", "union", "-o", &part]);
    (directory, part)
}

fn place(directory: &TempDir, name: &str) -> String {
    directory.path().join(name).to_str().unwrap().to_owned()
}

/// A layer of a CLI file: its top, the points of its polylines with their directions, and the ends of its hatches.
struct CliLayer {
    top_um: f32,
    polylines: Vec<(i32, Vec<[f32; 2]>)>,
    hatch_ends: Vec<[f32; 2]>,
}

/// Reads a binary file of the Common Layer Interface with the long commands. Coordinates are in units of 1 µm.
fn read_cli(path: &Path) -> Vec<CliLayer> {
    let bytes = std::fs::read(path).unwrap();
    let end = b"$$HEADEREND";
    let at = bytes.windows(end.len()).position(|window| window == end).unwrap();
    let header = std::str::from_utf8(&bytes[..at]).unwrap();
    assert!(header.contains("$$UNITS/0.001\n") && header.contains("$$BINARY\n"), "{header}");
    let mut rest = &bytes[at + end.len()..];
    let mut layers: Vec<CliLayer> = Vec::new();
    let word = |rest: &mut &[u8]| {
        let (first, others) = rest.split_first_chunk::<4>().unwrap();
        *rest = others;
        *first
    };
    let long = |rest: &mut &[u8]| i32::from_le_bytes(word(rest));
    let points = |rest: &mut &[u8], count: i32| -> Vec<[f32; 2]> {
        (0..count).map(|_| [f32::from_le_bytes(word(rest)), f32::from_le_bytes(word(rest))]).collect()
    };
    while let Some((command, others)) = rest.split_first_chunk::<2>() {
        rest = others;
        match u16::from_le_bytes(*command) {
            127 => {
                let top_um = f32::from_le_bytes(word(&mut rest));
                layers.push(CliLayer { top_um, polylines: Vec::new(), hatch_ends: Vec::new() });
            }
            130 => {
                let [_id, direction, count] = [0; 3].map(|_| long(&mut rest));
                let polyline = (direction, points(&mut rest, count));
                layers.last_mut().unwrap().polylines.push(polyline);
            }
            132 => {
                let [_id, count] = [0; 2].map(|_| long(&mut rest));
                let ends = points(&mut rest, 2 * count);
                layers.last_mut().unwrap().hatch_ends.extend(ends);
            }
            other => panic!("command {other}"),
        }
    }
    layers
}

fn from_axis_um([x, y]: [f32; 2]) -> f64 {
    (f64::from(x) - MIDDLE_UM).hypot(f64::from(y) - MIDDLE_UM)
}

#[test]
fn a_post_has_a_compensated_contour_and_hatches_inside_it() {
    let (directory, part) = post();
    let file = place(&directory, "post.cli");
    let told = done(&[
        "slice", &part, "-m", "sim-slm", "-r", "slm-demo", "--layers", "40..44", "--format", "cli", "-o", &file,
    ]);
    assert!(told.contains("4 layers in") && told.contains("m of jumps"), "{told}");
    let layers = read_cli(Path::new(&file));
    assert_eq!(layers.len(), 4);
    let contour_um = RADIUS_UM - BEAM_UM / 2.0;
    for (number, layer) in layers.iter().enumerate() {
        assert_eq!(f64::from(layer.top_um), (41 + number) as f64 * 30.0, "the top of layer {}", 40 + number);
        let [(1, ring)] = layer.polylines.as_slice() else { panic!("one outer contour: {:?}", layer.polylines) };
        assert_eq!(ring.first(), ring.last(), "it is closed");
        // Simplification may leave the border by 5 µm; points are whole micrometres.
        assert!(ring.iter().all(|point| (from_axis_um(*point) - contour_um).abs() < 7.0), "{ring:?}");
        assert!(
            layer.hatch_ends.len() > 50 && layer.hatch_ends.iter().all(|end| from_axis_um(*end) < contour_um + 7.0)
        );
        // Hatches of 60 µm spacing cover the disc within the contour. Stripes overlap.
        let length_um: f64 = layer
            .hatch_ends
            .chunks(2)
            .map(|ends| {
                (f64::from(ends[0][0]) - f64::from(ends[1][0])).hypot(f64::from(ends[0][1]) - f64::from(ends[1][1]))
            })
            .sum();
        let area_um2 = std::f64::consts::PI * contour_um * contour_um;
        assert!((0.97..1.08).contains(&(length_um * 60.0 / area_um2)), "{length_um}");
    }
    assert_ne!(layers[0].hatch_ends, layers[1].hatch_ends, "each layer is turned");
}

#[test]
fn the_files_of_a_part_do_not_depend_on_threads_or_the_first_layer() {
    let (directory, part) = post();
    let slice = |name: &str, more: &[&str]| {
        let file = place(&directory, name);
        let mut arguments = vec!["slice", &part, "-m", "sim-slm", "-r", "slm-demo", "-o", &file];
        arguments.extend(more);
        done(&arguments);
        file
    };
    // The name of the file is in it.
    let [one, three] = ["1", "3"].map(|threads| {
        let options = ["--format", "ovf", "--threads", threads, "--layers", "..4"];
        let read = std::fs::read(slice("part.ovf", &options)).unwrap();
        std::fs::remove_file(place(&directory, "part.ovf")).unwrap();
        read
    });
    assert!(one == three && one.len() > 1000);
    // The layers below and above are compared for skins: they are the same ones wherever a run begins.
    let [all, late] = [("all", "..6"), ("late", "4..6")].map(|(name, layers)| slice(name, &["--layers", layers]));
    for layer in ["layer_000004.svg", "layer_000005.svg"] {
        let [all, late] =
            [&all, &late].map(|directory| std::fs::read_to_string(Path::new(directory).join(layer)).unwrap());
        assert!(all == late && all.contains("class=\"contour\"") && all.contains("class=\"hatch\""));
    }
    let first = std::fs::read_to_string(Path::new(&all).join("layer_000000.svg")).unwrap();
    assert!(first.contains("class=\"down-skin\"") && !first.contains("class=\"hatch\""), "nothing lies below layer 0");
}

#[test]
fn what_does_not_go_together_is_told() {
    let (directory, part) = post();
    let taken = place(&directory, "taken");
    std::fs::create_dir(&taken).unwrap();
    let fresh = place(&directory, "fresh");
    let cases: [(&[&str], &[&str]); 5] = [
        (&["-m", "sim-slm", "-r", "slm-demo", "--format", "png", "-o", &fresh], &["marks vectors", "svg"]),
        (&["-m", "sim-slm", "-r", "slm-demo", "--antialias", "-o", &fresh], &["--antialias", "vectors"]),
        (&["-m", "sim-slm", "-r", "slm-demo", "--format", "cli", "-o", &taken], &["taken", "directory", "one file"]),
        (&["-m", "sim-dlp", "--format", "svg", "-o", &fresh], &["--format svg", "laser", "png"]),
        (&["-m", "sim-slm", "-o", &fresh], &["`dlp`", "`slm`", "choose a recipe"]),
    ];
    for (arguments, words) in cases {
        let output = layerctl(Path::new("."), &[&["slice", &part], arguments].concat());
        let told = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {told}");
        for word in words {
            assert!(told.contains(word), "{arguments:?}: `{word}` is not in: {told}");
        }
        assert!(!Path::new(&fresh).exists(), "{arguments:?}");
    }
}
