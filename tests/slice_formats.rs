//! `layerctl slice --format`: every format holds the same layers; what cannot be written is refused.

mod support;

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::Output;

use support::layerctl;

/// A directory with a machine of 1440 × 2560 pixels, a recipe and a part of one strut, packed.
fn bench() -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a directory");
    let machine = "name = \"bench\"\nkind = \"dlp\"\nwidth_px = 1440\nheight_px = 2560\npixel_um = [47.25, 47.25]\n\
                   build_height_um = 100000.0\nclear_height_um = 30000.0\n[link]\npath = \"device\"\nbaud = 3000000\n";
    let recipe = "name = \"quick\"\nlayer_height_um = 100.0\nexposure_ms = 400\nbottom_exposure_ms = 9000\n\
                  bottom_layers = 4\ntransition_layers = 3\nlift_height_um = 3000\nlift_speed_um_s = 2000\n\
                  retract_speed_um_s = 2000\nantialias = true\n";
    let part = "1 0.3 0.45 0.0\n0 0 0 4 1 3 0.3\n";
    for (name, text) in [("machine.toml", machine), ("recipe.toml", recipe), ("part.txt", part)] {
        fs::write(dir.path().join(name), text).expect("written");
    }
    let packed = layerctl(dir.path(), &["pack", "part.txt", "-o", "part.layerd"]);
    assert!(packed.status.success(), "{}", stderr(&packed));
    dir
}

fn slice(dir: &Path, more: &[&str]) -> Output {
    layerctl(dir, &[&["slice", "part.layerd", "-m", "machine.toml", "-r", "recipe.toml"], more].concat())
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// An entry of a zip file.
fn entry(path: &Path, name: &str) -> Vec<u8> {
    let mut zip = zip::ZipArchive::new(fs::File::open(path).expect("the file")).expect("a zip");
    let mut bytes = Vec::new();
    zip.by_name(name).expect("the entry").read_to_end(&mut bytes).expect("its bytes");
    bytes
}

#[test]
fn an_sl1_holds_the_pictures_that_a_print_sends_and_the_exposures_of_the_recipe() {
    let dir = bench();
    let pictures = slice(dir.path(), &["--layers", "2..9", "-o", "layers"]);
    assert!(pictures.status.success(), "{}", stderr(&pictures));
    let archive = slice(dir.path(), &["--layers", "2..9", "--format", "sl1", "-o", "strut.sl1"]);
    assert!(archive.status.success(), "{}", stderr(&archive));
    assert_eq!(String::from_utf8_lossy(&archive.stdout), "7 layers in strut.sl1\n");
    let path = dir.path().join("strut.sl1");
    let image = |bytes: &[u8]| image::load_from_memory(bytes).expect("a picture").into_luma8();
    for layer in 0..7 {
        let sliced = fs::read(dir.path().join(format!("layers/layer_{:06}.png", layer + 2))).expect("a picture");
        assert!(image(&sliced) == image(&entry(&path, &format!("strut{layer:05}.png"))), "layer {layer}");
    }
    let config = String::from_utf8(entry(&path, "config.ini")).expect("text");
    for line in
        ["printerModel = SL1", "expTime = 0.4", "expTimeFirst = 9", "numFade = 5", "numFast = 7", "layerHeight = 0.1"]
    {
        assert!(config.lines().any(|found| found == line), "{line} is not in\n{config}");
    }
    // Four seconds and more a layer: 3 mm up and down at 2 mm a second.
    let time = config.lines().find_map(|line| line.strip_prefix("printTime = ")).expect("a time");
    assert!((30..80).contains(&time.parse::<u32>().expect("seconds")), "{time}");
}

#[test]
fn what_no_file_can_be_is_refused() {
    let dir = bench();
    fs::create_dir(dir.path().join("taken.sl1")).expect("made");
    for (output, told) in [
        ("strut.zip", "ends with .sl1 or .sl1s"),
        ("taken.sl1", "ends with .sl1 or .sl1s"),
        ("missing/strut.sl1", "cannot write missing/strut.sl1"),
    ] {
        let sliced = slice(dir.path(), &["--format", "sl1", "-o", output]);
        assert_eq!(sliced.status.code(), Some(1), "{output}");
        assert!(stderr(&sliced).contains(told), "{}", stderr(&sliced));
    }
    let unknown = slice(dir.path(), &["--format", "gcode", "-o", "x"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(stderr(&unknown).contains("png"), "{}", stderr(&unknown));
}

/// Three pictures a layer, and an archive of each material.
#[test]
fn a_part_of_several_materials_becomes_a_picture_and_an_archive_of_each() {
    let dir = bench();
    let part = "3 0.3 0 0\n0 0 0 4 1 3 0.3 soft\n4 1 3 8 0 6 0.3 soft rigid\n0 3 0 4 1 3 0.3 rigid\n";
    fs::write(dir.path().join("part.txt"), part).expect("written");
    let pack =
        ["pack", "part.txt", "--joint", "elliptic", "--theta1", "20", "--materials", "soft=flex", "-o", "part.layerd"];
    let packed = layerctl(dir.path(), &pack);
    assert!(packed.status.success(), "{}", stderr(&packed));
    let told = String::from_utf8_lossy(&packed.stdout).into_owned();
    assert!(told.contains("material      flex, ") && told.contains("material      rigid, "), "{told}");
    assert!(told.contains("lattice, elliptic, support R"), "{told}");
    let sliced = slice(dir.path(), &["--layers", "10..13", "-o", "layers"]);
    assert!(sliced.status.success(), "{}", stderr(&sliced));
    let manifest = fs::read_to_string(dir.path().join("layers/manifest.json")).expect("a manifest");
    let manifest: serde_json::Value = serde_json::from_str(&manifest).expect("JSON");
    assert_eq!(manifest["materials"], serde_json::json!(["flex", "rigid"]));
    let named = |name: &serde_json::Value| dir.path().join("layers").join(name.as_str().expect("a name"));
    for layer in manifest["layers"].as_array().expect("layers") {
        let colours = image::open(named(&layer["file"])).expect("a picture").into_rgb8();
        let masks: Vec<_> = layer["masks"]
            .as_array()
            .expect("masks")
            .iter()
            .map(|name| image::open(named(name)).expect("a picture").into_luma8())
            .collect();
        assert_eq!(masks.len(), 2);
        let mut lit = [0; 2];
        for (x, y, colour) in colours.enumerate_pixels() {
            let of_masks = [0, 1].map(|mask| masks[mask].get_pixel(x, y).0[0]);
            assert!(of_masks.contains(&0), "{x}, {y} is of both materials");
            // Orange and blue: the first material has more red than blue.
            let first = colour.0[0] > colour.0[2];
            // A grey of 1 has no colour.
            assert!(colour.0 == [0; 3] || of_masks != [0; 2]);
            assert!(colour.0 != [0; 3] || of_masks.iter().all(|grey| *grey < 8));
            assert!(
                of_masks[usize::from(!first)] > 0 || colour.0.iter().all(|part| *part < 8),
                "{x}, {y}: {colour:?}, {of_masks:?}"
            );
            lit[0] += usize::from(of_masks[0] > 0);
            lit[1] += usize::from(of_masks[1] > 0);
        }
        assert!(lit.iter().all(|count| *count > 20), "{lit:?}");
    }
    let archives = slice(dir.path(), &["--layers", "10..13", "--format", "sl1", "-o", "part.sl1"]);
    assert!(archives.status.success(), "{}", stderr(&archives));
    assert_eq!(String::from_utf8_lossy(&archives.stdout), "3 layers: flex in part_1.sl1, rigid in part_2.sl1\n");
    let image = |bytes: &[u8]| image::load_from_memory(bytes).expect("a picture").into_luma8();
    for material in 1..3 {
        let path = dir.path().join(format!("part_{material}.sl1"));
        let sliced =
            image::open(dir.path().join(format!("layers/layer_000011_material_{material}.png"))).expect("a picture");
        assert!(sliced.into_luma8() == image(&entry(&path, "part00001.png")));
    }
}

#[test]
fn angles_and_names_that_cannot_be_are_refused() {
    let dir = bench();
    for (arguments, told) in [
        (&["--joint", "elliptic"][..], "--joint elliptic needs --theta1"),
        (&["--theta1", "20"], "--theta1 applies to --joint elliptic"),
        (&["--joint", "elliptic", "--theta1", "50"], "--theta1 50: allowed is 0.1 to 44.9 degrees"),
        (&["--joint", "elliptic", "--theta1", "20", "--theta2", "30"], "--theta2 30: allowed is 45.1 to 89.9 degrees"),
        (&["--materials", "a"], "`a`: write NAME=NAME"),
        (&["--materials", "a=b"], "the sources name no material"),
        (&["--joint", "union", "--support", "2"], "a union has no kernel"),
    ] {
        let packed = layerctl(dir.path(), &[&["pack", "part.txt", "-o", "other.layerd"], arguments].concat());
        assert!(!packed.status.success() && stderr(&packed).contains(told), "{arguments:?}: {}", stderr(&packed));
    }
}
