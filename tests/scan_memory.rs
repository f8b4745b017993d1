//! What layers of scan vectors take of memory: an allocator counts it, and it is never more than what the budget is charged.
//!
//! The tests run one after the other, because the allocator counts all threads.

#![allow(clippy::unwrap_used, reason = "a test may fail by panicking, helpers included")]

#[path = "scan_samples/mod.rs"]
mod scan_samples;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use layerd::buildfile::{BuildFile, GenerateOptions, Height, Kind, generate};
use layerd::device::encoding::LayerEncoder;
use layerd::layer::{Depth, LaserParameters, MarkClass, Mirror, Raster, Vectors};
use layerd::slice::scan::{Contours, Fill, FillError, HatchStrategy, Neighbours, Region, ScanCounts, ScanSettings};
use layerd::slice::{BodySource, SlicePlan};
use layerd::stream::MemoryBudget;
use layerd_wire::encoding::VectorEncoding;
use peak_alloc::PeakAlloc;
use scan_samples::{Random, disc, ellipse, islands, rectangle, settings, star};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The most memory that `work` took at once, bytes, and what it returned.
fn taken<T>(work: impl FnOnce() -> T) -> (usize, T) {
    ALLOCATOR.reset_peak_usage();
    let before = ALLOCATOR.current_usage();
    let returned = work();
    (ALLOCATOR.peak_usage() - before, returned)
}

const CHESSBOARD: HatchStrategy = HatchStrategy::Chessboard { island_um: 600.0, overlap_um: 50.0 };
const STRIPES: HatchStrategy = HatchStrategy::Stripes { width_um: 700.0, overlap_um: 50.0 };

/// Fills a layer, and checks that it does not take more than it is charged, nor in a list that keeps the vectors.
fn assert_charged(name: &str, settings: &ScanSettings, threads: usize, regions: &[Region], above: Option<&[Region]>) {
    let budget = MemoryBudget::new(1 << 40);
    let mut fill = Fill::new(settings.clone(), threads, &budget).unwrap();
    let neighbours = Neighbours { above, below: above };
    // Threads of the pool take their stacks and queues when they are first used.
    fill.groups::<FillError>(0, &regions[..1], neighbours, |_| Ok(())).unwrap();
    budget.take_peak_bytes();
    let (bytes, counts) = taken(|| fill.groups::<FillError>(3, regions, neighbours, |_| Ok(())).unwrap());
    let charged = budget.take_peak_bytes();
    assert!(bytes as u64 <= charged, "{name}: {bytes} bytes taken, {charged} charged");
    println!("{name}: {:.1} times what is taken is charged", charged as f64 / bytes as f64);
    assert_eq!(budget.used_bytes(), 0, "{name}: all is free again");
    let mut vectors = Vectors::default();
    let (bytes, whole) = taken(|| fill.layer(3, regions, neighbours, &mut vectors).unwrap());
    assert!(bytes as u64 <= budget.peak_bytes(), "{name}: {bytes} bytes taken, {} charged", budget.peak_bytes());
    assert!(budget.used_bytes() >= vectors.memory_bytes() as u64 && whole == counts, "{name}");
}

/// A plate with many holes, as a layer through the horizontal struts of a lattice.
fn net(cells: u32, hole_um: f64, points: u32) -> Region {
    let mut region = rectangle([100.0; 2], [100.0 + 500.0 * f64::from(cells); 2]);
    for number in 0..cells * cells {
        let centre = [number % cells, number / cells].map(|cell| 350.0 + 500.0 * f64::from(cell));
        let mut hole = ellipse(centre, [hole_um, hole_um * 0.95], 0.3, points);
        hole.reverse();
        region.holes.push(hole);
    }
    region
}

/// A star whose points lie between a share of a radius and the radius, 19 µm apart around it.
fn random_star(random: &mut Random, count: u32, least: f64) -> Region {
    let radius_um = 3.0 * f64::from(count) + 500.0;
    let radii: Vec<f64> = (0..count).map(|_| random.between(least * radius_um, radius_um)).collect();
    star([radius_um + 10.0; 2], &radii)
}

#[test]
fn single_regions_take_no_more_than_they_are_charged() {
    let _alone = alone();
    let mut random = Random(1);
    for strategy in [HatchStrategy::Zigzag, CHESSBOARD, STRIPES] {
        let plain = settings(strategy);
        let all_points = ScanSettings { simplify_tolerance_um: 0.0, contour_count: 3, ..plain.clone() };
        let narrow = ScanSettings { contour_only_below_um: 900.0, contour_spacing_um: 30.0, ..plain.clone() };
        for settings in [&plain, &all_points, &narrow] {
            let check = |name: &str, region: Region| {
                assert_charged(&format!("{name}, {settings:?}"), settings, 1, &[region], None);
            };
            for (hole_um, points) in [(240.0, 20), (220.0, 20), (190.0, 20), (150.0, 20), (200.0, 6)] {
                check("net", net(12, hole_um, points));
            }
            check("thin wall", rectangle([100.0; 2], [50_000.0, 200.0]));
            check("wall", rectangle([100.0; 2], [50_000.0, 300.0]));
            check("plate", rectangle([100.0; 2], [15_000.0; 2]));
            check("disc", disc([9000.0; 2], 8000.0));
            for count in [10, 100, 800] {
                check("star", random_star(&mut random, count, 0.3));
                check("rough star", random_star(&mut random, count, 0.95));
            }
        }
    }
}

#[test]
fn a_rough_border_of_many_corners_takes_little() {
    let _alone = alone();
    let mut random = Random(1);
    let mut rough = Region::default();
    for count in [10, 100, 1000, 5000] {
        random_star(&mut random, count, 0.3);
        rough = random_star(&mut random, count, 0.95);
    }
    // Moved in one step by the library, this border took 100 MB.
    let mut fill = Fill::new(settings(HatchStrategy::Zigzag), 1, &MemoryBudget::new(1 << 30)).unwrap();
    let filled = || fill.groups::<FillError>(3, &[rough], Neighbours::default(), |_| Ok(())).unwrap();
    let (bytes, _) = taken(filled);
    assert!(bytes < 16 << 20, "{bytes}");
}

#[test]
fn layers_of_many_regions_and_skins_take_no_more_than_they_are_charged() {
    let _alone = alone();
    let regions = islands(3000, 40.0, 400.0, 7);
    let mixed: Vec<Region> = [net(10, 190.0, 20)].into_iter().chain(islands(300, 100.0, 900.0, 5)).collect();
    for strategy in [HatchStrategy::Zigzag, CHESSBOARD] {
        let plain = settings(strategy);
        let skins = ScanSettings { up_skin: plain.hatch.clone(), down_skin: plain.hatch.clone(), ..plain.clone() };
        for threads in [1, 2] {
            assert_charged("islands", &plain, threads, &regions, None);
            assert_charged("mixed", &plain, threads, &mixed, None);
            assert_charged("islands with skins", &skins, threads, &regions[..1000], Some(&regions[50..]));
            assert_charged("mixed with skins", &skins, threads, &mixed, Some(&mixed[..200]));
        }
    }
}

/// Parts that fill the field of a machine, or have as many holes, teeth or islands as they can.
#[test]
fn hostile_regions_take_no_more_than_they_are_charged() {
    let _alone = alone();
    for strategy in [HatchStrategy::Zigzag, CHESSBOARD] {
        let plain = settings(strategy);
        let check = |name: &str, regions: &[Region]| assert_charged(name, &plain, 2, regions, None);
        check("disc of the whole field", &[disc([62_500.0; 2], 62_000.0)]);
        check("net of 3600 holes", &[net(60, 190.0, 20)]);
        check("net of 3600 holes with narrow webs", &[net(60, 240.0, 20)]);
        for tooth_um in [60.0, 150.0, 400.0] {
            check("comb", &[comb(150, tooth_um, 20_000.0)]);
        }
        check("tiny islands", &islands(20_000, 20.0, 90.0, 3));
    }
}

/// A bar with teeth as wide as the gaps between them.
fn comb(teeth: u32, tooth_um: f64, long_um: f64) -> Region {
    let (bottom_um, back_um) = (100.0, 1_100.0);
    let end_um = 100.0 + 2.0 * tooth_um * f64::from(teeth);
    let mut outer = vec![[100.0, bottom_um], [end_um, bottom_um], [end_um, back_um]];
    for tooth in (0..teeth).rev() {
        let left_um = 100.0 + 2.0 * tooth_um * f64::from(tooth);
        let (right_um, tip_um) = (left_um + tooth_um, back_um + long_um);
        outer.extend([[right_um, back_um], [right_um, tip_um], [left_um, tip_um], [left_um, back_um]]);
    }
    Region { outer, holes: Vec::new() }
}

const SIDE_MM: f64 = 45.0;

/// A lattice with some 9000 struts in a layer, and its plan on pixels of 30 µm.
fn dense_lattice(directory: &std::path::Path) -> (Arc<BuildFile>, SlicePlan) {
    let path = directory.join("dense.layerd");
    let options = GenerateOptions {
        kind: Kind::Bcc,
        struts: 60_000,
        footprint_mm: [SIDE_MM; 2],
        height: Height::Mm(4.0),
        radius_mm: Some(0.12),
        seed: 0,
    };
    generate(&path, &options, &mut |_, _| {}).unwrap();
    let file = Arc::new(BuildFile::open(&path).unwrap());
    let side_px = (SIDE_MM * 1000.0 / 30.0) as u32 + 40;
    let raster = Raster {
        width_px: side_px,
        height_px: side_px,
        pixel_um: [30.0; 2],
        build_height_um: 9000.0,
        mirror: Mirror::default(),
    };
    let plan = SlicePlan::new(file.header(), raster, Depth::Bit, 30.0).unwrap();
    (file, plan)
}

/// What a layer of a print gives.
struct Printed {
    counts: ScanCounts,
    vectors: u32,
    groups: u32,
    bytes: Vec<u8>,
}

/// A layer from the file to bytes, as a print computes it.
fn print_layer(
    file: &Arc<BuildFile>,
    plan: &SlicePlan,
    layer: u32,
    budget: &MemoryBudget,
) -> Result<Printed, FillError> {
    let settings = settings(HatchStrategy::Zigzag);
    let mut contours = Contours::new(BodySource::of(file), plan.clone(), 5.0, 1, layer, budget)?;
    let mut fill = Fill::new(settings.clone(), 1, budget)?;
    let regions = contours.next_layer()?.unwrap();
    let mut bytes = Vec::with_capacity(1 << 20);
    let lasers = [LaserParameters::default(); MarkClass::ALL.len()];
    let field_um = [plan.raster.width_px * 30; 2];
    let mut encoder =
        LayerEncoder::new(VectorEncoding::Coded, field_um, &lasers, &settings.classes(), &mut bytes).unwrap();
    let mut groups = 0;
    let counts = fill.groups::<FillError>(layer, regions.regions(), Neighbours::default(), |group| {
        groups += 1;
        encoder.add(group).unwrap();
        Ok(())
    })?;
    let vectors = encoder.finish().unwrap().vectors;
    Ok(Printed { counts, vectors, groups, bytes })
}

#[test]
fn a_dense_layer_is_computed_within_a_small_budget_and_is_the_same_in_any() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let (file, plan) = dense_lattice(directory.path());
    let roomy = MemoryBudget::new(1 << 40);
    let (bytes, printed) = taken(|| print_layer(&file, &plan, 10, &roomy).unwrap());
    // The encoder's output is not part of what contours and filling charge.
    let (need_bytes, encoded_bytes) = (roomy.peak_bytes(), 1 << 20);
    assert!(bytes as u64 <= need_bytes + encoded_bytes, "{bytes} bytes taken, {need_bytes} charged");
    assert!(printed.vectors > 150_000 && printed.groups > 2, "{} vectors", printed.vectors);
    assert!(need_bytes < 26 << 20, "{need_bytes} bytes for {} vectors", printed.vectors);

    // Just enough gives the same bytes, and a byte less is an error that says how much is missing.
    let just = print_layer(&file, &plan, 10, &MemoryBudget::new(need_bytes)).unwrap();
    assert!(just.bytes == printed.bytes && just.counts == printed.counts);
    let refused = print_layer(&file, &plan, 10, &MemoryBudget::new(need_bytes - 1)).err().unwrap().to_string();
    assert!(refused.contains("layer 10 is too complex") && refused.contains("are free"), "{refused}");
}
