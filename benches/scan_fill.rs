//! Vectors a second of one thread, from the regions of a layer to ordered vectors. Items are vectors.
//!
//! Islands are like the sections of a real lattice, 645 between 40 and 400 µm wide; plates are 4 mm wide.

#[path = "../tests/scan_samples/mod.rs"]
mod scan_samples;

use layerd::layer::Vectors;
use layerd::slice::scan::{Fill, HatchStrategy, Region, ScanSettings};
use scan_samples::{islands, settings};

fn main() {
    divan::main();
}

/// What is marked.
const KINDS: [&str; 5] = ["contours", "zigzag", "stripes", "chessboard", "skins"];

#[divan::bench(args = KINDS, sample_count = 20, sample_size = 1)]
fn lattice_645_islands(bencher: divan::Bencher<'_, '_>, kind: &str) {
    bench(bencher, kind, &islands(645, 40.0, 400.0, 7));
}

#[divan::bench(args = KINDS, sample_count = 10, sample_size = 1)]
fn plates_100(bencher: divan::Bencher<'_, '_>, kind: &str) {
    bench(bencher, kind, &islands(100, 1000.0, 4000.0, 7));
}

fn bench(bencher: divan::Bencher<'_, '_>, kind: &str, regions: &[Region]) {
    let strategy = match kind {
        "stripes" => HatchStrategy::Stripes { width_um: 700.0, overlap_um: 50.0 },
        "chessboard" => HatchStrategy::Chessboard { island_um: 600.0, overlap_um: 50.0 },
        _ => HatchStrategy::Zigzag,
    };
    let mut settings = settings(strategy);
    if kind == "contours" {
        settings.hatch = None;
    }
    if kind == "skins" {
        settings = ScanSettings { up_skin: settings.hatch.clone(), down_skin: settings.hatch.clone(), ..settings };
    }
    // A layer above that leaves strips of all widths.
    let above: Vec<Region> = regions.iter().map(|region| moved(region, 100.0)).collect();
    let mut fill = Fill::new(settings, 1).expect("good settings");
    let mut vectors = Vectors::default();
    let mut run = || {
        vectors.clear();
        fill.layer(3, regions, Some(&above), Some(&above), &mut vectors).expect("a layer");
        vectors.mark_count()
    };
    let count = run();
    bencher.counter(divan::counter::ItemsCount::new(count)).bench_local(run);
}

fn moved(region: &Region, by_um: f64) -> Region {
    let ring = |ring: &Vec<[f64; 2]>| ring.iter().map(|[x, y]| [x + by_um, *y]).collect();
    Region { outer: ring(&region.outer), holes: region.holes.iter().map(ring).collect() }
}
