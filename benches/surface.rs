//! Layers of solids that triangles enclose: time and memory against the number of voxels and of triangles. `cargo bench --bench surface`
//!
//! The part is a ball with waves, so that planes cut it in many places. The displaced one is a ball of few triangles that a height map makes
//! rough; its time is that of dividing triangles. Voxels are those of the box around it, as many along each axis.
//! Times are processor time of one thread, reading and drawing, without encoding. Exponents are those of neighbouring rows.

mod cpu_time;

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use cpu_time::cpu_time;
use layerd::buildfile::{
    BodySettings, BuildFile, DisplacementOptions, PackOptions, Placement, QUANTUM_FRACTIONS, Tile, Triangle, Writer,
    WriterSettings, pack,
};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, SlicePlan, Slicer};
use layerd::stream::MemoryBudget;

/// Radius of the ball, micrometres.
const RADIUS_UM: f64 = 20_000.0;

/// Waves around the ball, and their height as a share of the radius.
const WAVES: f64 = 12.0;
const WAVE_SHARE: f64 = 0.05;

/// Voxels along each side of the box.
const SIDES: [u32; 4] = [125, 250, 500, 1000];

/// Rings of triangles around the ball: the number of triangles is 4 n².
const RINGS: [u32; 4] = [16, 50, 158, 500];

/// Heights of the displaced ball's map, in voxels of which there are 1000 along the ball.
const DISPLACEMENTS: [f64; 2] = [6.0, 20.0];

/// Rings of the displaced ball, and the size of its map.
const COARSE_RINGS: u32 = 24;
const MAP_SIZE: [u32; 2] = [2048, 1024];

/// Each case is measured so often, in turn with the others of its table, and the least time counts: other programs disturb all alike.
const ROUNDS: usize = 7;

fn main() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let written = |rings: u32| written(&directory.path().join(format!("{rings}.layerd")), rings);
    let file = written(158);
    table("Time against voxels", &SIDES.map(|side| Case::new(&file, side)));
    table("Time against triangles", &RINGS.map(|rings| Case::new(&written(rings), 1000)));
    for (kind, is_noise) in [("waves", false), ("noise", true)] {
        for voxels in DISPLACEMENTS {
            let file = displaced(directory.path(), voxels, is_noise);
            let title = format!("{kind} up to {voxels} of 1000 voxels high, against voxels");
            table(&title, &SIDES.map(|side| Case::new(&file, side)));
        }
    }
}

/// What is measured: a part on a raster.
struct Case {
    file: Arc<BuildFile>,
    side: u32,
    plan: SlicePlan,
    /// Memory of slicing.
    bytes: u64,
}

impl Case {
    /// So many voxels along each side.
    fn new(file: &Arc<BuildFile>, side: u32) -> Self {
        let bounds = file.header().bounds;
        let size_um = [0, 1, 2].map(|axis| f64::from(bounds.max[axis] - bounds.min[axis]));
        let [x_um, y_um, z_um] = size_um.map(|size| size / f64::from(side));
        let raster = Raster {
            width_px: side + 1,
            height_px: side + 1,
            pixel_um: [x_um, y_um],
            build_height_um: size_um[2],
            mirror: Mirror::default(),
        };
        let plan = SlicePlan::new(file.header(), raster, Depth::Bit, z_um).expect("it fits");
        let bytes = Slicer::memory_bytes(&BodySource::of(file), &plan, 1);
        Self { file: Arc::clone(file), side, plan, bytes }
    }

    /// Slices the whole part, and returns the processor time, seconds.
    fn seconds(&self) -> f64 {
        let budget = MemoryBudget::new(self.bytes);
        let mut slicer = Slicer::new(BodySource::of(&self.file), self.plan.clone(), 1, 0, &budget).expect("a slicer");
        let mut bitmap = Bitmap::new(self.side + 1, self.side + 1, Depth::Bit);
        let began = cpu_time();
        while slicer.next_layer(&mut bitmap).expect("a layer").is_some() {}
        (cpu_time() - began).as_secs_f64()
    }

    fn voxels(&self) -> f64 {
        f64::from(self.side).powi(3)
    }

    fn triangles(&self) -> f64 {
        self.file.chunks().iter().map(|chunk| f64::from(chunk.count)).sum()
    }
}

/// Measures cases and prints a line for each.
fn table(title: &str, cases: &[Case]) {
    let mut seconds = vec![f64::INFINITY; cases.len()];
    for _ in 0..ROUNDS {
        for (seconds, case) in seconds.iter_mut().zip(cases) {
            *seconds = seconds.min(case.seconds());
        }
    }
    println!("\n{title}");
    println!(
        "triangles | Mvoxel | ms a layer | s per Mvoxel | times the first | bytes per voxel | file bytes a triangle | exponent"
    );
    for (number, case) in cases.iter().enumerate() {
        let exponent = number.checked_sub(1).map_or(String::new(), |before| {
            let grown = |size: fn(&Case) -> f64| size(case) / size(&cases[before]);
            let growth = grown(Case::voxels).max(grown(Case::triangles));
            format!("{:.2}", (seconds[number] / seconds[before]).ln() / growth.ln())
        });
        let per_mvoxel = |number: usize| seconds[number] / (cases[number].voxels() / 1e6);
        println!(
            "{} | {:.0} | {:.3} | {:.6} | {:.2} | {:.5} | {:.1} | {exponent}",
            case.triangles(),
            case.voxels() / 1e6,
            seconds[number] * 1000.0 / f64::from(case.plan.layer_count),
            per_mvoxel(number),
            per_mvoxel(number) / per_mvoxel(0),
            case.bytes as f64 / case.voxels(),
            case.file.file_bytes() as f64 / case.triangles(),
        );
    }
}

/// Writes a ball of `4 rings²` triangles.
fn written(path: &Path, rings: u32) -> Arc<BuildFile> {
    let point = |ring: u32, column: u32| {
        let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
        let azimuth = std::f64::consts::TAU * f64::from(column % (2 * rings)) / f64::from(2 * rings);
        let across = if ring == 0 || ring == rings { 0.0 } else { polar.sin() };
        let wave = 1.0 + WAVE_SHARE * across * (WAVES * azimuth).sin() * (WAVES * polar).sin();
        let along = [across * azimuth.cos(), across * azimuth.sin(), -polar.cos()];
        along.map(|share| (share * RADIUS_UM * wave * QUANTUM_FRACTIONS as f64).round() as i64)
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for column in 0..2 * rings {
            let [a, b] = [point(ring, column), point(ring, column + 1)];
            let [c, d] = [point(ring + 1, column + 1), point(ring + 1, column)];
            triangles.extend([[a, b, c], [a, c, d]].map(Triangle::new));
        }
    }
    triangles.sort_by_key(|triangle| triangle.corners.map(|[x, y, z]| [z, y, x]));
    let settings = WriterSettings {
        quantum_um: 1.0,
        placement: Placement::Centred,
        source_digest: [0; 32],
        source_name: "ball".into(),
        bodies: vec![BodySettings::Surface],
    };
    let mut writer = Writer::create(path, settings).expect("can be created");
    triangles.into_iter().for_each(|triangle| writer.push_triangle(triangle).expect("in order"));
    writer.finish().expect("is whole");
    Arc::new(BuildFile::open(path).expect("is whole"))
}

/// Packs a ball of few triangles with a map.
fn displaced(directory: &Path, voxels: f64, is_noise: bool) -> Arc<BuildFile> {
    let [source, map, output] = ["ball.obj", "map.png", "displaced.layerd"].map(|name| directory.join(name));
    std::fs::write(&source, coarse_ball()).expect("can be written");
    write_map(&map, is_noise);
    let mut options = PackOptions::default();
    options.relief.map = Some(DisplacementOptions { map, tile: Tile::Wrap });
    options.relief.height_mm = Some(voxels * 2.0 * RADIUS_UM / 1000.0 / 1000.0);
    options.relief.is_curved = true;
    pack(&[source], &output, &options, &mut |_| {}).expect("can be packed");
    Arc::new(BuildFile::open(&output).expect("is whole"))
}

/// A ball of `4 rings²` triangles, less those at the poles, with texture coordinates, as OBJ.
fn coarse_ball() -> String {
    let mut text = String::new();
    let columns = 2 * COARSE_RINGS;
    for (ring, column) in (0..=COARSE_RINGS).flat_map(|ring| (0..=columns).map(move |column| (ring, column))) {
        let [u, v] = [f64::from(column) / f64::from(columns), f64::from(ring) / f64::from(COARSE_RINGS)];
        let (sin, cos) = (std::f64::consts::TAU * f64::from(column % columns) / f64::from(columns)).sin_cos();
        let across = if ring == 0 || ring == COARSE_RINGS { 0.0 } else { (std::f64::consts::PI * v).sin() };
        let normal = [across * cos, across * sin, -(std::f64::consts::PI * v).cos()];
        let [x, y, z] = normal.map(|part| part * RADIUS_UM / 1000.0);
        writeln!(text, "v {x} {y} {z}\nvn {} {} {}\nvt {u} {v}", normal[0], normal[1], normal[2]).expect("a string");
    }
    let corner = |ring: u32, column: u32| {
        let number = ring * (columns + 1) + column + 1;
        format!("{number}/{number}/{number}")
    };
    for (ring, column) in (0..COARSE_RINGS).flat_map(|ring| (0..columns).map(move |column| (ring, column))) {
        let [a, b] = [corner(ring, column), corner(ring, column + 1)];
        let [c, d] = [corner(ring + 1, column + 1), corner(ring + 1, column)];
        // At the poles, two corners are one.
        if ring > 0 {
            writeln!(text, "f {a} {b} {c}").expect("a string");
        }
        if ring + 1 < COARSE_RINGS {
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
