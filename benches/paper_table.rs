//! Table 4 of Liu et al. 2021 with lattices of the same size: seconds a layer and the process's peak memory, row by row.
//!
//! ```text
//! cargo bench --bench paper_table                      all rows; Kitten-HR's build file takes 0.8 GB and minutes to make
//! cargo bench --bench paper_table -- bunny spot        rows whose names contain one of these words
//! cargo bench --bench paper_table -- bunny --doubled   besides, each row with twice the struts in about twice the height
//! ```
//!
//! The paper's models are not public. Each stand-in is `layerctl generate random` with the row's struts, most active struts
//! and picture. Build files are made in a temporary directory, or kept in `$LAYERD_TABLE_DIR` for the next run; remove them
//! when `generate` changes.
//!
//! Each measurement is a process of its own (this program runs itself), so that the peak memory, `VmHWM` from the operating
//! system, is that of one row and one number of threads: build file, active set, drawing and one picture. Timed is
//! `Slicer::next_layer`, with reading and decoding of chunks, over consecutive layers of the middle third of the part, of
//! `spot_lattice.txt` over all of it; of several passes the fastest counts.
//!
//! # What bounds a row
//!
//! The second table counts, for one layer: looks (a strut is looked at by each band of rows that it may reach in its life),
//! struts drawn (in two bands where one reaches both), their rows, and fields evaluated (cells, in vectors of eight). Counted in
//! instructions of the AVX2 path, a look takes some 25, a strut drawn 75 to cut it with the plane and 100 to 150 to begin its
//! patch or rows, a vector of eight fields 12 to 19 where no end of the strut is within reach, 26 to 34 with one, 35 to 41 with
//! both, and a pixel to pack 1.5.
//!
//! - Kitten-HR: a million struts of 30 cells each. About 650 instructions a strut: some 230 to evaluate 7.8 vectors, half of them
//!   empty cells; 85 to cut it, 60 to look at it, 25 to pack; most of the rest to begin patches. Decoding and taking in 80,000
//!   struts a layer is about a twentieth. The processor guesses two branches a strut wrong: which patch, and how many rows. What
//!   did not help: drawing from left to right, so that the strip's part stays in the cache (half the level-2 misses, the same time).
//! - The others: struts of 100 to 2,500 cells, about two fields a pixel: bound by field evaluations, then by packing. Few of them
//!   can be left out for certain. A strut's field bends by at most 16/3 of its weight a square of R, in any direction, which bounds
//!   a sum between points where it is known. Known on every second row and column, that leaves 26 % of Teddy's tiles of 8 × 2
//!   pixels open and 54 % of Bunny's; on every fourth, 43 and 94 % of 8 × 4. With what had to be known first, half of Teddy's
//!   fields would be spared and a fifth of Bunny's. A bound that knows where on its kernel each strut is would be the next step.
//! - spot: few pixels are near a strut; bound by what is done for every band and by looks.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use layerd::buildfile::{BuildFile, GenerateOptions, Height, Kind, PackOptions, generate, pack};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, SlicePlan, Slicer};
use layerd::solid::Effort;
use layerd::stream::MemoryBudget;
use serde::{Deserialize, Serialize};

/// A row of the paper's table, and how its stand-in is made.
struct Row {
    name: &'static str,
    struts: u64,
    /// Most struts at one plane.
    active: u64,
    image_px: [u32; 2],
    /// Memory budget of the slicer.
    budget_mib: u64,
    /// The paper's.
    seconds: f64,
    pixel_um: f64,
    /// Mean radius, chosen for a solid share of about a quarter.
    radius_px: f64,
}

const fn row(name: &'static str, struts: u64, active: u64, image_px: [u32; 2], seconds: f64, radius_px: f64) -> Row {
    Row { name, struts, active, image_px, budget_mib: 48, seconds, pixel_um: 50.0, radius_px }
}

const ROWS: [Row; 8] = [
    row("teddy", 17_462, 1_720, [1536, 768], 0.10, 7.9),
    row("kitten", 122_925, 38_439, [1489, 1368], 18.82, 2.05),
    row("camel", 12_241, 2_642, [1456, 728], 1.10, 5.9),
    row("horse", 16_301, 1_152, [1592, 796], 0.09, 9.9),
    row("finger", 359_212, 21_490, [1808, 904], 15.63, 2.55),
    row("bone", 75_484, 17_303, [2768, 1384], 14.50, 4.45),
    row("bunny", 123_610, 26_069, [3648, 1824], 26.47, 4.7),
    Row { budget_mib: 96, pixel_um: 20.0, ..row("kitten-hr", 101_514_060, 1_061_866, [5728, 2864], 347.23, 1.2) },
];

/// `spot_lattice.txt`: of today's programs the best, on two cores, takes 0.098 s for a layer; that is not the paper's figure.
const SPOT: Row = row("spot", 145_371, 0, [1080, 1920], 0.098, 0.0);

/// A pass ends with its layers, or when it has lasted this long and drawn as many layers.
const PASS_TIME: Duration = Duration::from_secs(8);
const PASS_LAYERS: u32 = 20;

/// Passes are repeated until they have lasted this long together, and at most so often.
const MIN_TIME: Duration = Duration::from_secs(2);
const MAX_PASSES: u32 = 20;

/// What a process is asked to measure; it travels as JSON in its argument.
#[derive(Serialize, Deserialize)]
struct Order {
    file: PathBuf,
    image_px: [u32; 2],
    pixel_um: f64,
    threads: usize,
    budget_mib: u64,
    /// Every layer instead of the middle third.
    whole: bool,
}

/// What it found; it travels as JSON on its standard output.
#[derive(Serialize, Deserialize)]
struct Found {
    layer_count: u32,
    /// A layer's share of [`Effort`].
    looks: f64,
    drawn: f64,
    rows: f64,
    evaluations: f64,
    seconds: f64,
    active: usize,
    solid: f64,
    /// By the slicer's own account.
    need_mib: f64,
    resident_mib: f64,
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    if let [flag, order] = arguments.as_slice()
        && flag == "--measure"
    {
        println!("{}", serde_json::to_string(&measure(&serde_json::from_str(order)?)?)?);
        return Ok(());
    }
    let doubled = arguments.iter().any(|argument| argument == "--doubled");
    let words: Vec<&String> = arguments.iter().filter(|argument| !argument.starts_with("--")).collect();
    let wanted = |row: &&Row| words.is_empty() || words.iter().any(|word| row.name.contains(word.as_str()));

    let temporary = tempfile::tempdir()?;
    let kept = std::env::var_os("LAYERD_TABLE_DIR").map(PathBuf::from);
    let directory = kept.as_deref().unwrap_or(temporary.path());
    std::fs::create_dir_all(directory)?;
    println!(
        "{:<14} {:>11} {:>9} {:>11} {:>6} {:>6} {:>10} {:>10} {:>10} {:>9} {:>7} {:>9}",
        "row",
        "struts",
        "active",
        "image",
        "layers",
        "solid",
        "MiB",
        "s, 1 thr.",
        "s, 2 thr.",
        "paper s",
        "ratio",
        "need MiB"
    );
    let mut efforts = Vec::new();
    for row in ROWS.iter().filter(wanted) {
        let path = directory.join(format!("{}.layerd", row.name));
        made(&path, row, 1)?;
        efforts.push(print_row(row, row.name, &path, false)?);
        if doubled {
            let path = directory.join(format!("{}-doubled.layerd", row.name));
            made(&path, row, 2)?;
            efforts.push(print_row(row, &format!("{} × 2", row.name), &path, false)?);
        }
    }
    if wanted(&&SPOT) {
        let path = directory.join("spot.layerd");
        match packed_spot(&path)? {
            true => efforts.push(print_row(&SPOT, SPOT.name, &path, true)?),
            false => println!("skipped: spot_lattice.txt is not in $LAYERD_DATA, default ../shared/data"),
        }
    }
    println!("\nWhat a layer takes, on average:");
    println!("{:<14} {:>11} {:>11} {:>11} {:>13} {:>9}", "row", "looks", "drawn", "rows", "evaluations", "a pixel");
    for line in &efforts {
        println!("{line}");
    }
    Ok(())
}

/// Measures with one and two threads, prints a line of the table and returns one of the table of efforts.
fn print_row(row: &Row, name: &str, file: &Path, whole: bool) -> anyhow::Result<String> {
    let [one, two] = [1, 2].map(|threads| -> anyhow::Result<Found> {
        let Row { image_px, pixel_um, budget_mib, .. } = *row;
        let order = Order { file: file.into(), image_px, pixel_um, threads, budget_mib, whole };
        let output = Command::new(std::env::current_exe()?)
            .args(["--measure", &serde_json::to_string(&order)?])
            .stderr(std::process::Stdio::inherit())
            .output()?;
        anyhow::ensure!(output.status.success(), "{name} with {threads} threads failed");
        Ok(serde_json::from_slice(&output.stdout)?)
    });
    let (one, two) = (one?, two?);
    let need = format!("{:.1}{}", two.need_mib, if two.need_mib > row.budget_mib as f64 { "!" } else { "" });
    println!(
        "{name:<14} {:>11} {:>9} {:>11} {:>6} {:>6.3} {:>10.1} {:>10.6} {:>10.6} {:>9.3} {:>7.0} {need:>9}",
        strut_count(&BuildFile::open(file)?),
        two.active,
        format!("{}×{}", row.image_px[0], row.image_px[1]),
        two.layer_count,
        two.solid,
        two.resident_mib,
        one.seconds,
        two.seconds,
        row.seconds,
        row.seconds / two.seconds,
    );
    let pixels = f64::from(row.image_px[0]) * f64::from(row.image_px[1]);
    Ok(format!(
        "{name:<14} {:>11.0} {:>11.0} {:>11.0} {:>13.0} {:>9.2}",
        one.looks,
        one.drawn,
        one.rows,
        one.evaluations,
        one.evaluations / pixels
    ))
}

fn strut_count(file: &BuildFile) -> u64 {
    file.header().lattices().map(|lattice| lattice.strut_count).sum()
}

/// The build file of a row, or of one with twice its struts and as many at the busiest plane, so about twice as high.
fn made(path: &Path, row: &Row, times: u64) -> anyhow::Result<()> {
    if BuildFile::open(path).is_ok_and(|file| strut_count(&file) == times * row.struts) {
        return Ok(());
    }
    // Radii reach one and a half of the mean, on either side; whole pixels leave room for rounding.
    let footprint_mm =
        row.image_px.map(|size_px| (f64::from(size_px) - 3.0 * row.radius_px).floor() * row.pixel_um / 1000.0);
    let options = GenerateOptions {
        kind: Kind::Random,
        struts: times * row.struts,
        footprint_mm,
        height: Height::Active(row.active),
        radius_mm: Some(row.radius_px * row.pixel_um / 1000.0),
        seed: 1,
    };
    generate(path, &options, &mut |_, _| {})?;
    Ok(())
}

/// Packs `spot_lattice.txt`; `false` where it is absent.
fn packed_spot(path: &Path) -> anyhow::Result<bool> {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let input = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from).join("spot_lattice.txt");
    if !input.is_file() {
        return Ok(false);
    }
    pack(&[input], path, &PackOptions::default(), &mut |_| {})?;
    Ok(true)
}

/// Draws and times layers in this process.
fn measure(order: &Order) -> anyhow::Result<Found> {
    let Order { ref file, image_px: [width_px, height_px], pixel_um, threads, budget_mib, whole } = *order;
    let part = Arc::new(BuildFile::open(file)?);
    let raster =
        Raster { width_px, height_px, pixel_um: [pixel_um; 2], build_height_um: 1e7, mirror: Mirror::default() };
    let plan = SlicePlan::new(part.header(), raster, Depth::Bit, pixel_um)?;
    let need_bytes = Slicer::memory_bytes(&BodySource::of(&part), &plan, threads);
    drop(part);
    let layer_count = plan.layer_count;
    let range = if whole { 1..layer_count } else { layer_count / 3..layer_count * 2 / 3 };
    let mut bitmap = Bitmap::new(width_px, height_px, Depth::Bit);
    let mut found = Found {
        layer_count,
        looks: 0.0,
        drawn: 0.0,
        rows: 0.0,
        evaluations: 0.0,
        seconds: f64::INFINITY,
        active: 0,
        solid: 0.0,
        need_mib: mib(need_bytes),
        resident_mib: 0.0,
    };
    let mut total = Duration::ZERO;
    let mut passes = 0;
    while passes < MAX_PASSES && total < MIN_TIME {
        // A row that needs more than its budget is marked in the table and measured all the same.
        let budget = MemoryBudget::new(need_bytes.max(budget_mib << 20));
        // The layer before the first one timed takes in all that lies within its reach.
        let mut slicer = Slicer::new(
            BodySource::of(&Arc::new(BuildFile::open(file)?)),
            plan.clone(),
            threads,
            range.start - 1,
            &budget,
        )?;
        slicer.next_layer(&mut bitmap)?;
        let before = slicer.effort();
        let (mut time, mut layers, mut lit_px) = (Duration::ZERO, 0, 0);
        while layers < range.end - range.start && (layers < PASS_LAYERS || time < PASS_TIME) {
            let start = Instant::now();
            slicer.next_layer(&mut bitmap)?;
            time += start.elapsed();
            layers += 1;
            found.active = found.active.max(slicer.active_count());
            lit_px += bitmap.data().iter().map(|byte| u64::from(byte.count_ones())).sum::<u64>();
        }
        found.solid = lit_px as f64 / (f64::from(layers) * f64::from(width_px) * f64::from(height_px));
        found.seconds = found.seconds.min(time.as_secs_f64() / f64::from(layers));
        let after = slicer.effort();
        let per_layer = |count: fn(&Effort) -> u64| (count(&after) - count(&before)) as f64 / f64::from(layers);
        found.looks = per_layer(|effort| effort.looks);
        found.drawn = per_layer(|effort| effort.drawn);
        found.rows = per_layer(|effort| effort.rows);
        found.evaluations = per_layer(|effort| effort.evaluations);
        total += time;
        passes += 1;
    }
    found.resident_mib = resident_peak_mib()?;
    Ok(found)
}

/// `VmHWM`: the most memory this process has had resident, as the kernel counts it.
fn resident_peak_mib() -> anyhow::Result<f64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let kib =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.trim().parse().ok());
    let kib: f64 = kib.ok_or_else(|| anyhow::anyhow!("/proc/self/status has no VmHWM"))?;
    Ok(kib / 1024.0)
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}
