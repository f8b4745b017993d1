//! Layers of solids that a height map makes rough: time and memory against the number of voxels. `cargo bench --bench displaced`
//!
//! The time is that of dividing triangles and of cutting what they are divided into. The first parts are balls of few triangles. The last is
//! the cow `spot_uv.obj`, on a raster of 1080 × 1920 pixels; it is looked for in `$LAYERD_DATA`, default `../shared/data`.
//! Voxels are those of the box around a part, as many along each axis. Times are processor time of one thread, reading and drawing, without
//! encoding. Exponents are those of neighbouring rows.

mod cpu_time;
mod sliced;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use layerd::buildfile::{BuildFile, DisplacementOptions, PackOptions, Tile, pack};
use layerd::layer::{Depth, Mirror, Raster};
use layerd::slice::SlicePlan;
use sliced::{Case, table};

/// Radius of the ball, millimetres.
const RADIUS_MM: f64 = 20.0;

/// Voxels along each side of the box.
const SIDES: [u32; 4] = [125, 250, 500, 1000];

/// Heights of the map of a ball, in voxels of which there are 1000 along the ball.
const DISPLACEMENTS: [f64; 2] = [6.0, 20.0];

/// Rings of the ball, and the size of its map.
const RINGS: u32 = 24;
const MAP_SIZE: [u32; 2] = [2048, 1024];

/// The cow fills the picture: it is 0.94 × 1.72 units wide and long, and 1.69 high.
const COW_SCALE: f64 = 54.0;
const COW_DISPLACEMENT_MM: f64 = 0.3;
const COW_PX: [u32; 2] = [1080, 1920];
const COW_PIXEL_UM: f64 = 50.0;
const COW_LAYER_UM: f64 = 100.0;

fn main() {
    let directory = tempfile::tempdir().expect("temporary directory");
    for (kind, is_noise) in [("waves", false), ("noise", true)] {
        for voxels in DISPLACEMENTS {
            let file = ball(directory.path(), voxels, is_noise);
            let title = format!("{kind} up to {voxels} of 1000 voxels high, against voxels");
            table(&title, &SIDES.map(|side| Case::new(&file, side)));
        }
    }
    match cow(directory.path()) {
        Some(file) => table("the cow, with waves", &[cow_case(&file)]),
        None => println!("skipped: spot_uv.obj is not there"),
    }
}

/// The cow with waves; `None` where its file is not there.
fn cow(directory: &Path) -> Option<Arc<BuildFile>> {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let source = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from).join("spot_uv.obj");
    // In the file, y points upwards.
    let options = PackOptions { scale: [COW_SCALE; 3], rotate_deg: [90.0, 0.0, 0.0], ..PackOptions::default() };
    source.exists().then(|| packed(directory, &source, options, COW_DISPLACEMENT_MM, false))
}

fn cow_case(file: &Arc<BuildFile>) -> Case {
    let raster = Raster {
        width_px: COW_PX[0],
        height_px: COW_PX[1],
        pixel_um: [COW_PIXEL_UM; 2],
        build_height_um: 100_000.0,
        mirror: Mirror::default(),
    };
    let plan = SlicePlan::new(file.header(), raster, Depth::Bit, COW_LAYER_UM).expect("it fits");
    Case::of_plan(file, plan)
}

/// Packs a ball of few triangles with a map, of so many voxels of a thousandth of its diameter.
fn ball(directory: &Path, voxels: f64, is_noise: bool) -> Arc<BuildFile> {
    let source = directory.join("ball.obj");
    std::fs::write(&source, coarse_ball()).expect("can be written");
    let mut options = PackOptions::default();
    options.relief.is_curved = true;
    packed(directory, &source, options, voxels * 2.0 * RADIUS_MM / 1000.0, is_noise)
}

/// Packs a source with a map.
fn packed(directory: &Path, source: &Path, mut options: PackOptions, height_mm: f64, is_noise: bool) -> Arc<BuildFile> {
    let [map, output] = ["map.png", "displaced.layerd"].map(|name| directory.join(name));
    write_map(&map, is_noise);
    options.relief.map = Some(DisplacementOptions { map, tile: Tile::Wrap });
    options.relief.height_mm = Some(height_mm);
    pack(&[source.to_path_buf()], &output, &options, &mut |_| {}).expect("can be packed");
    Arc::new(BuildFile::open(&output).expect("is whole"))
}

/// A ball of `4 rings²` triangles, less those at the poles, with texture coordinates, as OBJ.
fn coarse_ball() -> String {
    let mut text = String::new();
    let columns = 2 * RINGS;
    for (ring, column) in (0..=RINGS).flat_map(|ring| (0..=columns).map(move |column| (ring, column))) {
        let [u, v] = [f64::from(column) / f64::from(columns), f64::from(ring) / f64::from(RINGS)];
        let (sin, cos) = (std::f64::consts::TAU * f64::from(column % columns) / f64::from(columns)).sin_cos();
        let across = if ring == 0 || ring == RINGS { 0.0 } else { (std::f64::consts::PI * v).sin() };
        let normal = [across * cos, across * sin, -(std::f64::consts::PI * v).cos()];
        let [x, y, z] = normal.map(|part| part * RADIUS_MM);
        writeln!(text, "v {x} {y} {z}\nvn {} {} {}\nvt {u} {v}", normal[0], normal[1], normal[2]).expect("a string");
    }
    let corner = |ring: u32, column: u32| {
        let number = ring * (columns + 1) + column + 1;
        format!("{number}/{number}/{number}")
    };
    for (ring, column) in (0..RINGS).flat_map(|ring| (0..columns).map(move |column| (ring, column))) {
        let [a, b] = [corner(ring, column), corner(ring, column + 1)];
        let [c, d] = [corner(ring + 1, column + 1), corner(ring + 1, column)];
        // At the poles, two corners are one.
        if ring > 0 {
            writeln!(text, "f {a} {b} {c}").expect("a string");
        }
        if ring + 1 < RINGS {
            writeln!(text, "f {a} {c} {d}").expect("a string");
        }
    }
    text
}

/// Smooth waves, or a value of its own for each texel.
fn write_map(path: &Path, is_noise: bool) {
    let [width, height] = MAP_SIZE;
    let texel = |column: u32, row: u32| {
        let [u, v] = [f64::from(column) / f64::from(width), f64::from(row) / f64::from(height)];
        if is_noise {
            return ((f64::from(column) * 12.9898 + f64::from(row) * 78.233).sin() * 43_758.545_3).rem_euclid(1.0);
        }
        0.5 + 0.5 * (40.0 * std::f64::consts::TAU * u).sin() * (20.0 * std::f64::consts::TAU * v).sin()
    };
    let texels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
    let bytes: Vec<u8> =
        texels.flat_map(|(column, row)| ((texel(column, row) * 65_535.0) as u16).to_be_bytes()).collect();
    let file = std::fs::File::create(path).expect("can be created");
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.write_header().expect("a head").write_image_data(&bytes).expect("texels");
}
