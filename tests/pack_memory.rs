//! What `pack` takes of memory: an allocator counts it. It is what `pack` says that it needs, or less.
//!
//! There is one test at a time, because the allocator counts all threads.

use std::fmt::Write as _;

use layerd::buildfile::{PackOptions, ReliefOptions, pack};
use peak_alloc::PeakAlloc;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

/// Memory of reading a file and of small lists, bytes.
const FIXED_BYTES: u64 = 3 << 20;

/// A binary cloud of points with normals upwards.
fn cloud(points: impl ExactSizeIterator<Item = [f32; 3]>) -> Vec<u8> {
    let mut head = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", points.len());
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        writeln!(head, "property float {name}").expect("a string");
    }
    let mut bytes = (head + "end_header\n").into_bytes();
    for point in points {
        bytes.extend(
            point.map(|at| 10.0 * at + 10.0).iter().chain(&[0.0, 0.0, 1.0]).flat_map(|number| number.to_le_bytes()),
        );
    }
    bytes
}

/// A number from 0 to 1 that looks random.
fn noise(number: u32) -> f32 {
    (number.wrapping_mul(0x9e37_79b9) >> 8) as f32 / (1 << 24) as f32
}

#[test]
fn a_cloud_of_points_takes_no_more_than_is_said() {
    const COUNT: u32 = 300_000;
    let directory = tempfile::tempdir().expect("temporary directory");
    let (source, output) = (directory.path().join("cloud.ply"), directory.path().join("out.layerd"));
    let relief = ReliefOptions { shell_mm: Some(1.0), ..ReliefOptions::default() };
    let refused = |options: PackOptions| {
        let refused = pack(&[&source].map(Into::into), &output, &options, &mut |_| {});
        refused.expect_err("it does not fit").to_string()
    };
    for (name, point) in [
        ("each in a cell of its own", (|n| [noise(3 * n), noise(3 * n + 1), noise(3 * n + 2)]) as fn(u32) -> [f32; 3]),
        ("on a plane", |n| [noise(2 * n), noise(2 * n + 1), 0.0]),
        ("on a line", |n| [n as f32 / COUNT as f32, 0.0, 0.0]),
    ] {
        std::fs::write(&source, cloud((0..COUNT).map(point).collect::<Vec<_>>().into_iter())).expect("can be written");
        let error = refused(PackOptions { memory_bytes: 1 << 20, relief: relief.clone(), ..PackOptions::default() });
        let said_mib =
            error.split(" take ").nth(1).and_then(|rest| rest.split(" MiB").next()).and_then(|n| n.parse().ok());
        let said_mib: f64 = said_mib.unwrap_or_else(|| panic!("{error}"));
        // Enough for the points. Then the first disc is out of range, so that nothing else takes memory.
        let options = PackOptions {
            memory_bytes: ((said_mib + 0.1) * 1_048_576.0) as u64,
            scale: [1e6; 3],
            relief: relief.clone(),
            ..PackOptions::default()
        };
        ALLOCATOR.reset_peak_usage();
        let before = ALLOCATOR.current_usage();
        let error = refused(options);
        let taken = (ALLOCATOR.peak_usage() - before) as u64;
        assert!(error.contains("vertex 1") && error.contains("farther than"), "{name}: {error}");
        let said = (said_mib * 1_048_576.0) as u64;
        assert!(taken <= said + FIXED_BYTES, "{name}: {taken} bytes taken, {said} said");
    }
}
