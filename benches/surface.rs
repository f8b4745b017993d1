//! Layers of solids that triangles enclose: time and memory against the number of voxels and of triangles. `cargo bench --bench surface`
//!
//! The part is a ball with waves, so that planes cut it in many places. Voxels are those of the box around it, as many along each axis.
//! Times are processor time of one thread, reading and drawing, without encoding. Exponents are those of neighbouring rows.

mod cpu_time;
mod sliced;

use std::path::Path;
use std::sync::Arc;

use layerd::buildfile::{BodySettings, BuildFile, Placement, QUANTUM_FRACTIONS, Triangle, Writer, WriterSettings};
use sliced::{Case, table};

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
    let written = |rings: u32| written(&directory.path().join(format!("{rings}.layerd")), rings);
    let file = written(158);
    table("Time against voxels", &SIDES.map(|side| Case::new(&file, side)));
    table("Time against triangles", &RINGS.map(|rings| Case::new(&written(rings), 1000)));
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
        materials: None,
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
