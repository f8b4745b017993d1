//! The pictures that `slice` writes, pixel by pixel, and the bytes that a print sends of them.

use std::fs;

use layerd::device::encoding::{best, encode, encode_shortest};
use layerd::layer::{Bitmap, Depth};
use layerd::link::message::Encoding;
use layerd::solid::reference::beam_field;
use layerd::solid::{Beam, Cap, ISOVALUE};
use serde_json::Value;

use crate::support::{layerctl, real_data};
use crate::{PART, Strut, bench, check, json, slice, stderr};

/// A chessboard of single pixels is shorter as it is than in Group 4, so a print sends it raw. So does the estimate.
#[test]
fn check_measures_the_bytes_that_a_print_sends() {
    let dir = bench("", &[]);
    let machine = "name = \"bench\"\nkind = \"dlp\"\nwidth_px = 32\nheight_px = 32\npixel_um = [100.0, 100.0]\n\
                   build_height_um = 9000.0\nclear_height_um = 9000.0\n[link]\npath = \"device\"\nbaud = 3000000\n";
    fs::write(dir.path().join("machine.toml"), machine).expect("written");
    let squares = (2..30).flat_map(|row| (2..30).map(move |column| (row, column)));
    let struts: Vec<_> = squares.filter(|(row, column)| (row + column) % 2 == 0).collect();
    let mut text = format!("{} 0.3 0.45 0.0\n", struts.len());
    for (row, column) in struts {
        let [x, y] = [column, row].map(|pixel| f64::from(pixel) / 10.0);
        text += &format!("{x} {y} 0 {x} {y} 0.5 0.02\n");
    }
    fs::write(dir.path().join("part.txt"), text).expect("written");
    let packed = layerctl(dir.path(), &["pack", "part.txt", "--joint", "union", "-o", "part.layerd"]);
    assert!(packed.status.success(), "{}", stderr(&packed));
    assert!(slice(dir.path(), &["-o", "layers"]).status.success());

    let found = json(&check(dir.path(), &["--json"]));
    let layer_count = found["layer_count"].as_u64().expect("a number");
    assert_eq!(found["sampled_layers"], layer_count, "every layer of so low a part");
    let mut lengths = Vec::new();
    for layer in 0..layer_count {
        let picture =
            image::open(dir.path().join(format!("layers/layer_{layer:06}.png"))).expect("a picture").into_luma8();
        let mut bitmap = Bitmap::new(32, 32, Depth::Bit);
        for (x, y, _) in picture.enumerate_pixels().filter(|(.., pixel)| pixel.0[0] > 0) {
            bitmap.data_mut()[(y * 4 + x / 8) as usize] |= 0x80 >> (x % 8);
        }
        let (mut group4, mut sent) = (Vec::new(), Vec::new());
        encode(&bitmap, Encoding::Group4, &mut group4).expect("bits");
        encode_shortest(&bitmap, best(Depth::Bit), &mut sent).expect("bits");
        assert!(layer > 2 || (group4.len() > 128 && sent.len() == 128), "layer {layer}: {} bytes", group4.len());
        lengths.push(sent.len() as u64);
    }
    assert_eq!(found["encoded_bytes_max"].as_u64(), lengths.iter().copied().max());
    assert_eq!(found["encoded_bytes_mean"], lengths.iter().sum::<u64>() / layer_count);
}

#[test]
fn pictures_of_an_earlier_slice_are_told_and_its_manifest_goes_first() {
    let dir = bench("", &[]);
    assert!(slice(dir.path(), &["--layers", "10..20", "-o", "layers"]).status.success());
    let again = slice(dir.path(), &["--layers", "12..15", "-o", "layers"]);
    assert!(again.status.success() && stderr(&again).contains("7 more pictures of layers"), "{}", stderr(&again));
    let layers = dir.path().join("layers");
    // A directory where a picture should be ends it on the way.
    fs::remove_file(layers.join("layer_000011.png")).expect("is there");
    fs::create_dir(layers.join("layer_000011.png")).expect("made");
    assert_eq!(slice(dir.path(), &["--layers", "10..20", "-o", "layers"]).status.code(), Some(1));
    assert!(!layers.join("manifest.json").exists(), "it would describe other pictures");
}

/// The field of the part at `p`, millimetres, in plain `f64`.
fn field(support_mm: f64, p: [f64; 3]) -> f64 {
    let beam = |(a, b, radius): Strut| Beam { a, b, radius_a: radius, radius_b: radius, caps: [Cap::Sphere; 2] };
    PART.iter().map(|strut| beam_field(&beam(*strut), support_mm, p)).sum()
}

#[test]
fn pixels_agree_with_the_mathematics_that_the_manifest_describes() {
    for (mirror, pack) in [
        ("", &[][..]),
        ("mirror = { x = true, y = false }", &[]),
        ("mirror = { x = true, y = true }", &["--at", "3.1,5.2"]),
    ] {
        let dir = bench(mirror, pack);
        let sliced = slice(dir.path(), &["--layers", "10..30", "-o", "layers"]);
        assert!(sliced.status.success(), "{}", stderr(&sliced));
        let read = fs::read(dir.path().join("layers/manifest.json")).expect("a manifest");
        let manifest: Value = serde_json::from_slice(&read).expect("JSON");
        let number = |value: &Value| value.as_f64().expect("a number");
        assert_eq!((&manifest["width_px"], &manifest["height_px"]), (&200.into(), &160.into()));
        let sign = |axis: &str| if manifest["mirror"][axis] == true { -1.0 } else { 1.0 };
        let step_mm = [0, 1].map(|axis| number(&manifest["pixel_um"][axis]) / 1000.0);
        let step_mm = [step_mm[0] * sign("x"), step_mm[1] * sign("y")];
        let (isovalue, support_mm) = (number(&manifest["isovalue"]), number(&manifest["bodies"][0]["support_mm"]));
        assert_eq!(manifest["layers"].as_array().map(Vec::len), Some(20));
        let mut seen = [0; 2];
        for layer in manifest["layers"].as_array().expect("layers") {
            let file = layer["file"].as_str().expect("a name");
            let picture = image::open(dir.path().join("layers").join(file)).expect("a picture").into_luma8();
            for (x, y, pixel) in picture.enumerate_pixels() {
                let p = [
                    number(&manifest["origin_mm"][0]) + f64::from(x) * step_mm[0],
                    number(&manifest["origin_mm"][1]) + f64::from(y) * step_mm[1],
                    number(&layer["z_mm"]),
                ];
                let field = field(support_mm, p) * isovalue / ISOVALUE;
                let undecided = (field - isovalue).abs() < 1e-5 * isovalue;
                let lit = pixel.0[0] == 255;
                assert!(undecided || lit == (field >= isovalue), "{file} {x} {y}: {field}, {mirror} {pack:?}");
                seen[usize::from(lit)] += 1;
            }
        }
        assert!(seen[1] > 5000 && seen[0] > 5000, "{seen:?}");
    }
}

#[test]
fn a_real_lattice_is_the_same_on_any_number_of_threads_and_from_any_layer() {
    let Some(text) = real_data("spot_lattice.txt") else { return };
    let dir = tempfile::tempdir().expect("a directory");
    let ok = |arguments: &[&str]| {
        let output = layerctl(dir.path(), arguments);
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    };
    let machine = "name = \"4K\"\nkind = \"dlp\"\nwidth_px = 3840\nheight_px = 2160\npixel_um = [20.0, 20.0]\n\
                   build_height_um = 100000.0\nclear_height_um = 30000.0\n[link]\npath = \"device\"\nbaud = 3000000\n";
    fs::write(dir.path().join("4k.toml"), machine).expect("written");
    let recipe = concat!(env!("CARGO_MANIFEST_DIR"), "/config/recipes/fine.toml");
    ok(&["pack", text.to_str().expect("UTF-8"), "--rotate", "0,0,90", "-o", "spot.layerd"]);
    let slice = ["slice", "spot.layerd", "-m", "4k.toml", "-r", recipe];
    ok(&[&slice[..], &["--threads", "1", "--layers", "1498..1502", "-o", "one"]].concat());
    ok(&[&slice[..], &["--threads", "3", "--layers", "1501..1502", "-o", "three"]].concat());
    let picture = |folder: &str| fs::read(dir.path().join(folder).join("layer_001501.png")).expect("a picture");
    assert!(picture("one") == picture("three"));
    let pixels = image::open(dir.path().join("one/layer_001501.png")).expect("a PNG").into_luma8();
    let lit = pixels.pixels().filter(|pixel| pixel.0[0] > 0).count();
    assert!(lit > 100_000, "{lit} pixels are lit");
}
