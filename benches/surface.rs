//! Layers of solids that triangles enclose: time and memory against the number of voxels and of triangles. `cargo bench --bench surface`
//!
//! The part is a ball with waves, so that planes cut it in many places. Voxels are those of the box around it, as many along each axis.
//! Times are processor time of one thread, reading and drawing, without encoding. Exponents are those of neighbouring rows.

mod cpu_time;

use std::path::Path;
use std::sync::Arc;

use cpu_time::cpu_time;
use layerd::buildfile::{BodySettings, BuildFile, Placement, QUANTUM_FRACTIONS, Triangle, Writer, WriterSettings};
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

fn main() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("ball.layerd");
    println!("Time against voxels, 99,856 triangles");
    table_head();
    let file = written(&path, 158);
    let mut before = None;
    for side in SIDES {
        before = Some(row(&file, side, before));
    }
    println!("\nTime against triangles, 10⁹ voxels");
    table_head();
    let mut before = None;
    for rings in RINGS {
        before = Some(row(&written(&path, rings), 1000, before));
    }
}

fn table_head() {
    println!("triangles | Mvoxel | ms a layer | s per Mvoxel | bytes per voxel | exponent");
}

/// What was measured: a size and a time.
type Measured = [f64; 3];

/// Slices the whole part and prints a line.
fn row(file: &Arc<BuildFile>, side: u32, before: Option<Measured>) -> Measured {
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
    let mut seconds = f64::INFINITY;
    for _ in 0..3 {
        let budget = MemoryBudget::new(bytes);
        let mut slicer = Slicer::new(BodySource::of(file), plan.clone(), 1, 0, &budget).expect("a slicer");
        let mut bitmap = Bitmap::new(side + 1, side + 1, Depth::Bit);
        let began = cpu_time();
        while slicer.next_layer(&mut bitmap).expect("a layer").is_some() {}
        seconds = seconds.min((cpu_time() - began).as_secs_f64());
    }
    let voxels = f64::from(side).powi(3);
    let triangles: f64 = file.chunks().iter().map(|chunk| f64::from(chunk.count)).sum();
    let exponent = before.map_or(String::new(), |[voxels_before, triangles_before, seconds_before]: Measured| {
        let grown = (voxels / voxels_before).max(triangles / triangles_before);
        format!("{:.2}", (seconds / seconds_before).ln() / grown.ln())
    });
    println!(
        "{triangles} | {:.0} | {:.3} | {:.6} | {:.5} | {exponent}",
        voxels / 1e6,
        seconds * 1000.0 / f64::from(plan.layer_count),
        seconds / (voxels / 1e6),
        bytes as f64 / voxels,
    );
    [voxels, triangles, seconds]
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
