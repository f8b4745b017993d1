//! Vectors a second of one thread. `cargo bench --bench scan_fill`
//!
//! First, from the regions of a layer to ordered vectors; items are vectors. Islands are like the sections of a real lattice, 645 between
//! 40 and 400 µm wide; plates are 4 mm wide.
//!
//! Then, step by step from the sweep to encoded bytes: 20 layers of 30 µm of `spot_lattice.txt` from z = 30 mm on, with contours and
//! zigzag hatches of a beam of 60 µm. The whole is processor time, so that other work on the machine counts little. Each step is given
//! its share of it. Looks for the file in `$LAYERD_DATA`, default `../shared/data`; without it this part is skipped.

mod cpu_time;
#[path = "../tests/scan_samples/mod.rs"]
mod scan_samples;
mod scan_steps;
mod spot_contours;

use std::time::{Duration, Instant};

use cpu_time::cpu_time;
use layerd::buildfile::Header;
use layerd::device::encoding::encode_vectors;
use layerd::layer::{LaserParameters, MarkClass, Vectors};
use layerd::slice::MemoryStruts;
use layerd::slice::scan::{Fill, HatchStrategy, Neighbours, Region, ScanSettings};
use layerd::stream::MemoryBudget;
use layerd_wire::encoding::VectorEncoding;
use scan_samples::{islands, settings};
use scan_steps::{contour_steps, print_step};
use spot_contours::{FIELD_UM, LAYERS};

fn main() {
    divan::main();
    for convolution in [true, false] {
        if let Some((header, source)) = spot_contours::lattice(convolution) {
            println!("{LAYERS} layers of spot_lattice.txt, convolution: {convolution}");
            print_steps(&header, &source);
        }
    }
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
    let mut fill = Fill::new(settings, 1, &MemoryBudget::new(1 << 30)).expect("good settings");
    let mut vectors = Vectors::default();
    let mut run = || {
        vectors.clear();
        fill.layer(3, regions, Neighbours { above: Some(&above), below: Some(&above) }, &mut vectors).expect("a layer");
        vectors.mark_count()
    };
    let count = run();
    bencher.counter(divan::counter::ItemsCount::new(count)).bench_local(run);
}

fn moved(region: &Region, by_um: f64) -> Region {
    let ring = |ring: &Vec<[f64; 2]>| ring.iter().map(|[x, y]| [x + by_um, *y]).collect();
    Region { outer: ring(&region.outer), holes: region.holes.iter().map(ring).collect() }
}

/// Prints what each step from the sweep to encoded bytes takes.
fn print_steps(header: &Header, source: &MemoryStruts) {
    let budget = MemoryBudget::new(1 << 30);
    let settings = settings(HatchStrategy::Zigzag);
    let mut contours = spot_contours::contours(header, source, settings.simplify_tolerance_um, 1, &budget);
    let mut fill = Fill::new(settings, 1, &budget).expect("good settings");

    let (mut vectors, mut bytes) = (Vectors::default(), Vec::new());
    let (mut count, mut byte_count, mut jump_um) = (0, 0, 0.0);
    let mut encoding = Duration::ZERO;
    let before = contours.times();
    let (began, began_cpu) = (Instant::now(), cpu_time());
    for _ in 0..LAYERS {
        let regions = contours.next_layer().expect("a layer").expect("a layer");
        vectors.clear();
        let counts =
            fill.layer(regions.layer(), regions.regions(), Neighbours::default(), &mut vectors).expect("it fits");
        let begin = Instant::now();
        encode_vectors(&vectors, VectorEncoding::Coded, FIELD_UM, &lasers(), &mut bytes).expect("in the field");
        encoding += begin.elapsed();
        count += vectors.mark_count();
        byte_count += bytes.len() as u64;
        jump_um += counts.jump_um;
    }
    let (whole, whole_cpu) = (began.elapsed(), cpu_time() - began_cpu);
    let per_vector = byte_count as f64 / count as f64;
    println!(
        "{count} vectors, {per_vector:.2} bytes each, {:.0} mm of jumps a layer",
        jump_um / 1e3 / f64::from(LAYERS)
    );
    println!("step | ms a layer | vectors a second");
    let of_fill = fill.times();
    let of_fill = [
        ("thin parts", of_fill.thin),
        ("contours", of_fill.contours),
        ("hatches", of_fill.hatch),
        ("narrow parts", of_fill.narrow),
        ("order", of_fill.order),
    ];
    let of_contours = contour_steps(before, contours.times());
    let processor_share = whole_cpu.as_secs_f64() / whole.as_secs_f64();
    for (step, time) in of_contours.into_iter().chain(of_fill).chain([("encoding", encoding), ("all", whole)]) {
        print_step(step, time.mul_f64(processor_share), LAYERS, count);
    }
}

fn lasers() -> [LaserParameters; MarkClass::ALL.len()] {
    let laser = LaserParameters {
        power_mw: 180_000,
        mark_speed_um_s: 1_000_000,
        jump_speed_um_s: 5_000_000,
        focus_um: 0,
        jump_delay_us: 100,
        mark_delay_us: 50,
        polygon_delay_us: 20,
        point_time_us: 500,
    };
    [laser; MarkClass::ALL.len()]
}
