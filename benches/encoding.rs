//! Bytes of layers on the line against PNG, and speed of encoding and decoding. `cargo bench --bench encoding`
//!
//! Packs `spot_lattice.txt` with `layerctl`, turned to lie on 3840 × 2160 pixels of 20 µm, and encodes and decodes every layer
//! of 20 µm on one thread. Every hundredth is written as PNG too, of the same depth: zlib level 9 and, for each picture, the
//! shortest of the five filters and of libpng's way to choose one for each row. Speeds are means over the print, of processor
//! time, so that other work on the machine counts little.
//!
//! Then 20 layers of scan vectors of the same lattice, upright, from z = 30 mm on: contours and zigzag hatches of a beam of 60 µm.
//! Looks for the file in `$LAYERD_DATA`, default `../shared/data`; without it there is nothing to measure.

mod cpu_time;
#[path = "../tests/scan_samples/mod.rs"]
mod scan_samples;
mod spot_contours;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use cpu_time::cpu_time;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use layerd::buildfile::BuildFile;
use layerd::device::encoding::{encode, encode_vectors};
use layerd::layer::{Bitmap, Depth, LaserParameters, MarkClass, Mirror, Raster, Vectors};
use layerd::link::message::Encoding;
use layerd::slice::scan::{Fill, HatchStrategy, Neighbours};
use layerd::slice::{BodySource, SlicePlan, Slicer};
use layerd::stream::MemoryBudget;
use layerd_wire::encoding::{Decoder, VectorDecoder, VectorEncoding};
use scan_samples::settings;
use spot_contours::FIELD_UM;

const RASTER: Raster = Raster {
    width_px: 3840,
    height_px: 2160,
    pixel_um: [20.0; 2],
    build_height_um: 100_000.0,
    mirror: Mirror { x: false, y: false },
};
const LAYER_HEIGHT_UM: f64 = 20.0;
/// A PNG at level 9 takes seconds, a hundred times as long as all else of a layer.
const LAYERS_PER_PNG: u32 = 100;
/// As they come from the line.
const PIECE_BYTES: usize = 1000;
/// How often the layers of vectors are encoded: once takes a tenth of a second.
const VECTOR_ROUNDS: usize = 10;

fn main() {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let lattice = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from).join("spot_lattice.txt");
    if !lattice.exists() {
        println!("skipped: {} is not there", lattice.display());
        return;
    }
    let directory = tempfile::tempdir().expect("a directory");
    let part = directory.path().join("spot.layerd");
    let packed = Command::new(env!("CARGO_BIN_EXE_layerctl"))
        .arg("pack")
        .arg(&lattice)
        .args(["--rotate", "0,0,90", "-o"])
        .arg(&part)
        .output()
        .expect("layerctl runs");
    assert!(packed.status.success(), "{}", String::from_utf8_lossy(&packed.stderr));

    println!("encoding | layers | bytes a layer | of the best PNG (layers) | encode Mpx/s | decode Mpx/s");
    for (depth, encoding) in [(Depth::Bit, Encoding::Group4), (Depth::Grey, Encoding::RunGrey)] {
        let sum = measure(&part, depth, encoding);
        let megapixels = f64::from(sum.layers) * f64::from(RASTER.width_px) * f64::from(RASTER.height_px) / 1e6;
        println!(
            "{:<8} | {:>6} | {:>13.0} | {:>16.4} {:>7} | {:>12.0} | {:>12.0}",
            format!("{encoding:?}"),
            sum.layers,
            sum.bytes as f64 / f64::from(sum.layers),
            sum.bytes_beside_png as f64 / sum.png_bytes as f64,
            format!("({})", sum.png_layers),
            megapixels / sum.encoding.as_secs_f64(),
            megapixels / sum.decoding.as_secs_f64(),
        );
    }
    println!("encoding | vectors | bytes a vector | encode Mvectors/s | decode Mvectors/s");
    let layers = scan_layers();
    for encoding in [VectorEncoding::Plain, VectorEncoding::Coded] {
        print_vectors(&layers, encoding);
    }
}

/// The vectors of some layers.
fn scan_layers() -> Vec<Vectors> {
    let budget = MemoryBudget::new(1 << 30);
    let settings = settings(HatchStrategy::Zigzag);
    let Some((header, source)) = spot_contours::lattice(true) else { return Vec::new() };
    let mut contours = spot_contours::contours(&header, &source, settings.simplify_tolerance_um, 1, &budget);
    let mut fill = Fill::new(settings, 1, &budget).expect("good settings");
    let layer = |_| {
        let regions = contours.next_layer().expect("a layer").expect("a layer");
        let mut vectors = Vectors::default();
        fill.layer(regions.layer(), regions.regions(), Neighbours::default(), &mut vectors).expect("it fits");
        vectors
    };
    (0..spot_contours::LAYERS).map(layer).collect()
}

/// Encodes and decodes layers, and prints how fast.
fn print_vectors(layers: &[Vectors], encoding: VectorEncoding) {
    let lasers = [LaserParameters::default(); MarkClass::ALL.len()];
    let (mut bytes, mut byte_count, mut count) = (Vec::new(), 0, 0);
    let (mut encoded, mut decoded) = (Duration::ZERO, Duration::ZERO);
    for vectors in layers.iter().cycle().take(VECTOR_ROUNDS * layers.len()) {
        let start = cpu_time();
        let sum = encode_vectors(vectors, encoding, FIELD_UM, &lasers, &mut bytes).expect("it lies in the field");
        encoded += cpu_time() - start;
        byte_count += bytes.len();
        count += vectors.mark_count();
        let start = cpu_time();
        let mut decoder = VectorDecoder::new(encoding, FIELD_UM, bytes.len() as u32);
        for mut piece in bytes.chunks(PIECE_BYTES) {
            while decoder.next(&mut piece).expect("its own bytes").is_some() {}
        }
        assert_eq!(decoder.finish().expect("a whole layer"), sum);
        decoded += cpu_time() - start;
    }
    let mega = |time: Duration| count as f64 / 1e6 / time.as_secs_f64();
    println!(
        "{:<8} | {:>7} | {:>14.2} | {:>17.1} | {:>17.1}",
        format!("{encoding:?}"),
        count / VECTOR_ROUNDS as u64,
        byte_count as f64 / count as f64,
        mega(encoded),
        mega(decoded)
    );
}

#[derive(Default)]
struct Sum {
    layers: u32,
    bytes: usize,
    encoding: Duration,
    decoding: Duration,
    /// Layers that were written as PNG too, what they took, and what they take on the line.
    png_layers: u32,
    png_bytes: usize,
    bytes_beside_png: usize,
}

fn measure(part: &Path, depth: Depth, encoding: Encoding) -> Sum {
    let file = Arc::new(BuildFile::open(part).expect("just packed"));
    let plan = SlicePlan::new(file.header(), RASTER, depth, LAYER_HEIGHT_UM).expect("it fits turned");
    let layers = plan.layer_count;
    let mut slicer = Slicer::new(BodySource::of(&file), plan, 1, 0, &MemoryBudget::new(1 << 30)).expect("fits");
    let mut bitmap = Bitmap::new(RASTER.width_px, RASTER.height_px, depth);
    let mut bytes = Vec::new();
    let mut sum = Sum { layers, ..Sum::default() };
    for layer in 0..layers {
        slicer.next_layer(&mut bitmap).expect("a layer");
        let start = cpu_time();
        encode(&bitmap, encoding, &mut bytes).expect("the depth fits");
        sum.encoding += cpu_time() - start;
        sum.bytes += bytes.len();

        let mut decoder = Decoder::new(encoding.picture().expect("a picture"), RASTER.width_px, RASTER.height_px);
        let start = cpu_time();
        for piece in bytes.chunks(PIECE_BYTES) {
            decoder.push(piece).expect("its own bytes");
        }
        let (read, _) = decoder.finish().expect("a whole picture");
        sum.decoding += cpu_time() - start;
        assert!(read == bitmap.data(), "layer {layer} came back changed");

        if layer % LAYERS_PER_PNG == LAYERS_PER_PNG / 2 {
            sum.png_layers += 1;
            sum.png_bytes += best_png_bytes(&bitmap);
            sum.bytes_beside_png += bytes.len();
        }
    }
    sum
}

/// Signature, header, the one data chunk's frame, end (PNG specification, third edition, 5).
const PNG_FRAME_BYTES: usize = 8 + 25 + 12 + 12;

/// The shortest PNG of a picture at its own depth.
fn best_png_bytes(bitmap: &Bitmap) -> usize {
    let filters: [&[u8]; 6] = [&[0], &[1], &[2], &[3], &[4], &[0, 1, 2, 3, 4]];
    let deflated = |filters: &&[u8]| {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(&filtered(bitmap, filters)).expect("memory takes it");
        encoder.finish().expect("memory takes it").len()
    };
    PNG_FRAME_BYTES + filters.iter().map(deflated).min().expect("six ways")
}

/// The rows as PNG filters them: each by the one of `filters` with the smallest sum of absolute values, as libpng chooses.
fn filtered(bitmap: &Bitmap, filters: &[u8]) -> Vec<u8> {
    let stride = bitmap.stride_bytes();
    let mut out = Vec::with_capacity((stride + 1) * bitmap.height_px() as usize);
    let blank = vec![0; stride];
    let mut above: &[u8] = &blank;
    for row in bitmap.data().chunks_exact(stride) {
        let rows = filters.iter().map(|filter| filtered_row(*filter, row, above));
        let weight = |row: &Vec<u8>| row[1..].iter().map(|byte| u32::from((*byte as i8).unsigned_abs())).sum::<u32>();
        out.extend(rows.min_by_key(weight).expect("a filter"));
        above = row;
    }
    out
}

fn filtered_row(filter: u8, row: &[u8], above: &[u8]) -> Vec<u8> {
    let guess = |x: usize| {
        let (left, corner) = if x == 0 { (0, 0) } else { (row[x - 1], above[x - 1]) };
        let up = above[x];
        match filter {
            0 => 0,
            1 => left,
            2 => up,
            3 => ((u16::from(left) + u16::from(up)) / 2) as u8,
            _ => paeth(left, up, corner),
        }
    };
    let rest = (0..row.len()).map(|x| row[x].wrapping_sub(guess(x)));
    std::iter::once(filter).chain(rest).collect()
}

/// The neighbour nearest to the plane through the three (A. W. Paeth, 1991).
fn paeth(left: u8, up: u8, corner: u8) -> u8 {
    let plane = i16::from(left) + i16::from(up) - i16::from(corner);
    // The first of equals, as the specification orders them.
    [left, up, corner].into_iter().min_by_key(|pixel| (plane - i16::from(*pixel)).abs()).unwrap_or(0)
}
