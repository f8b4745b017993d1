//! `layerctl check` and `layerctl slice` as an operator runs them: what they answer, refuse and write.

mod memory;
mod pictures;
mod plate;
mod refused;
#[path = "../support/mod.rs"]
mod support;
mod walls;

use std::fs;
use std::path::Path;
use std::process::Output;

use serde_json::Value;
use support::layerctl;

/// A strut of the part: ends and radius, millimetres.
type Strut = ([f64; 3], [f64; 3], f64);

const PART: [Strut; 5] = [
    ([0.0, 0.0, 0.0], [4.0, 1.0, 3.0], 0.3),
    ([4.0, 1.0, 3.0], [1.0, 5.0, 2.0], 0.25),
    ([0.0, 0.0, 0.0], [1.0, 5.0, 2.0], 0.3),
    ([1.0, 5.0, 2.0], [1.0, 2.5, 4.0], 0.2),
    ([4.0, 1.0, 3.0], [4.5, 4.5, 1.0], 0.35),
];

/// A directory with a machine of 200 × 160 pixels, a recipe and the part, packed.
fn bench(mirror: &str, pack: &[&str]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a directory");
    let machine = format!(
        "name = \"bench\"\nkind = \"dlp\"\nwidth_px = 200\nheight_px = 160\npixel_um = [50.0, 60.0]\n\
         build_height_um = 100000.0\nclear_height_um = 30000.0\n{mirror}\n[link]\npath = \"device\"\nbaud = 3000000\n"
    );
    let recipe = "name = \"bench\"\nlayer_height_um = 100.0\nexposure_ms = 400\nbottom_exposure_ms = 400\n\
                  bottom_layers = 0\nlift_height_um = 3000\nlift_speed_um_s = 2000\nretract_speed_um_s = 2000\n";
    let mut text = format!("{} 0.3 0.45 0.0\n", PART.len());
    for (a, b, r) in PART {
        text += &format!("{} {} {} {} {} {} {r}\n", a[0], a[1], a[2], b[0], b[1], b[2]);
    }
    for (name, text) in [("machine.toml", machine.as_str()), ("recipe.toml", recipe), ("part.txt", &text)] {
        fs::write(dir.path().join(name), text).expect("written");
    }
    let packed = layerctl(dir.path(), &[&["pack", "part.txt", "-o", "part.layerd"], pack].concat());
    assert!(packed.status.success(), "{}", stderr(&packed));
    dir
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The one JSON object on standard output.
fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {}\n{}", String::from_utf8_lossy(&output.stdout), stderr(output)))
}

const HERE: [&str; 4] = ["--machine", "machine.toml", "--recipe", "recipe.toml"];

fn check(dir: &Path, more: &[&str]) -> Output {
    layerctl(dir, &[&["check", "part.layerd"], &HERE[..], more].concat())
}

fn slice(dir: &Path, more: &[&str]) -> Output {
    layerctl(dir, &[&["slice", "part.layerd"], &HERE[..], more].concat())
}
