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
