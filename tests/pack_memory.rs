//! What packing, and drawing displaced parts, takes of memory: an allocator counts it. It is what is said or charged, or less.
//!
//! The tests run one after the other, because the allocator counts all threads.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use layerd::buildfile::{BuildFile, DisplacementOptions, PackOptions, PackProgress, ReliefOptions, Tile, pack};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, SlicePlan, Slicer};
use layerd::stream::MemoryBudget;
use peak_alloc::PeakAlloc;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Begins to count, and returns what is taken already, bytes.
fn begin_counting() -> usize {
    ALLOCATOR.reset_peak_usage();
    ALLOCATOR.current_usage()
}

/// The most that was taken at once since then, bytes.
fn taken_since(before: usize) -> u64 {
    (ALLOCATOR.peak_usage() - before) as u64
}

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
    let _alone = alone();
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
        let before = begin_counting();
        let error = refused(options);
        let taken = taken_since(before);
        assert!(error.contains("vertex 1") && error.contains("farther than"), "{name}: {error}");
        let said = (said_mib * 1_048_576.0) as u64;
        assert!(taken <= said + FIXED_BYTES, "{name}: {taken} bytes taken, {said} said");
    }
}

/// A file of `length` bytes that begins with these: the rest is zeros, which take no room on the disk.
fn sparse(path: &Path, begin: &[u8], length: u64) {
    std::fs::write(path, begin).expect("can be written");
    let file = std::fs::OpenOptions::new().write(true).open(path).expect("is there");
    file.set_len(length).expect("can be extended");
}

#[test]
fn sources_without_end_are_refused_within_little_memory() {
    const HUGE_BYTES: u64 = 10 << 30;
    let _alone = alone();
    let numbers = "12.5 ".repeat(1 << 20);
    let struts = "0 0 0 0 0 9\n".repeat(1 << 20);
    let vertices = "v 1.5 2.5 3.5\n".repeat(1 << 20);
    let stl = "solid s\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3";
    let ply = "ply\nformat ascii 1.0\nelement vertex 900000000\nproperty float x\nproperty float y\nproperty float z\n\
               element face 9\nproperty list uchar int vertex_indices\nend_header\n";
    let directory = tempfile::tempdir().expect("temporary directory");
    for (name, begin) in [
        ("zeros.txt", String::new()),
        ("line.txt", "3 0.5\n".to_owned() + &numbers),
        ("first line.txt", numbers.clone()),
        ("more than announced.txt", "3 0.5\n".to_owned() + &struts),
        ("announced.txt", "900000000000 0.5\n".to_owned() + &struts),
        ("zeros.obj", String::new()),
        ("line.obj", "v 0 0 0\nf ".to_owned() + &numbers),
        ("vertices.obj", vertices.clone()),
        ("zeros.stl", String::new()),
        ("line.stl", stl.to_owned() + &numbers),
        ("zeros.ply", String::new()),
        ("head.ply", "ply\nformat ascii 1.0\ncomment ".to_owned() + &numbers),
        ("line.ply", ply.to_owned() + &numbers),
        ("announced.ply", ply.to_owned()),
        ("zeros.3mf", String::new()),
        ("zip.3mf", "PK\u{3}\u{4}".to_owned() + &numbers),
    ] {
        let source = directory.path().join(name);
        sparse(&source, begin.as_bytes(), HUGE_BYTES);
        let options = PackOptions { memory_bytes: 4 << 20, ..PackOptions::default() };
        let mut read_bytes = 0;
        let mut progress = |step| {
            if let PackProgress::Reading { done, .. } = step {
                read_bytes = read_bytes.max(done);
            }
        };
        let before = begin_counting();
        let refused = pack(&[&source].map(Into::into), &directory.path().join("out.layerd"), &options, &mut progress);
        let taken = taken_since(before);
        let error = refused.expect_err(name).to_string();
        assert!(error.contains(name) || error.contains("beside the build file"), "{name}: {error}");
        assert!(taken <= (2 * 4 + 32) << 20, "{name}: {taken} bytes taken");
        assert!(read_bytes <= 64 << 20, "{name}: {read_bytes} bytes were read");
        std::fs::remove_file(&source).expect("is there");
    }
}

/// A plate of 20 × 20 mm, 2 mm thick, that a map makes rough on both sides.
fn rough_plate(directory: &Path, map_size: [u32; 2]) -> Arc<BuildFile> {
    let [source, map, output] = ["in.obj", "map.png", "out.layerd"].map(|name| directory.join(name));
    let mut text = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n".to_owned();
    for number in 0..8 {
        let at = |bit: u32, size: u32| (number >> bit & 1) * size;
        writeln!(text, "v {} {} {}", at(0, 20), at(1, 20), at(2, 2)).expect("a string");
    }
    for [a, b, c, d] in [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]] {
        writeln!(text, "f {a}/1 {b}/2 {c}/3\nf {a}/1 {c}/3 {d}/4").expect("a string");
    }
    std::fs::write(&source, text).expect("can be written");
    let texels: Vec<u8> = (0..map_size[0] * map_size[1]).map(|number| (255.0 * noise(number)) as u8).collect();
    let file = std::fs::File::create(&map).expect("can be created");
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), map_size[0], map_size[1]);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header().expect("a head").write_image_data(&texels).expect("texels");
    let relief = ReliefOptions {
        map: Some(DisplacementOptions { map, tile: Tile::Wrap }),
        height_mm: Some(0.3),
        ..ReliefOptions::default()
    };
    let options = PackOptions { relief, ..PackOptions::default() };
    pack(&[source], &output, &options, &mut |_| {}).expect("can be packed");
    Arc::new(BuildFile::open(&output).expect("is whole"))
}

#[test]
fn a_displaced_part_takes_no_more_than_is_charged() {
    let _alone = alone();
    let directory = tempfile::tempdir().expect("temporary directory");
    for (map_size, pixel_um) in [([2048, 32], 40.0), ([32, 2048], 100.0), ([700, 700], 40.0), ([1, 1], 100.0)] {
        let file = rough_plate(directory.path(), map_size);
        let size_px = (22_000.0 / pixel_um) as u32;
        let raster = Raster {
            width_px: size_px,
            height_px: size_px,
            pixel_um: [pixel_um; 2],
            build_height_um: 10_000.0,
            mirror: Mirror::default(),
        };
        let plan = SlicePlan::new(file.header(), raster, Depth::Bit, 50.0).expect("it fits");
        let mut bitmap = Bitmap::new(size_px, size_px, Depth::Bit);
        let budget = MemoryBudget::new(1 << 40);
        let before = begin_counting();
        let mut slicer = Slicer::new(BodySource::of(&file), plan, 1, 0, &budget).expect("it fits");
        while slicer.next_layer(&mut bitmap).expect("a layer").is_some() {}
        let (taken, charged) = (taken_since(before), budget.peak_bytes());
        println!("{map_size:?}: {taken} bytes taken, {charged} charged");
        assert!(taken <= charged, "{map_size:?}: {taken} bytes taken, {charged} charged");
        assert!(charged < 3 * taken, "{map_size:?}: {taken} bytes taken, {charged} charged");
    }
}
