//! Contours of `spot_lattice.txt` at z = 30 mm, on pixels of 30 µm: points a second for each step. `cargo bench --bench contours`
//!
//! divan's time is for 20 layers. Items are points after simplification, which are the vectors of a contour. The table below it divides
//! the time of the threads among the steps. Looks for the file in `$LAYERD_DATA`, default `../shared/data`; without it there is nothing
//! to measure.

mod spot;

use layerd::buildfile::Header;
use layerd::layer::{Depth, Mirror, Raster};
use layerd::slice::scan::{Contours, Region};
use layerd::slice::{BodySource, MemoryStruts, SlicePlan};
use layerd::stream::MemoryBudget;

fn main() {
    divan::main();
    print_steps(true);
    print_steps(false);
}

const PITCH_UM: f64 = 30.0;
const Z_UM: f64 = 30_000.0;
const LAYERS: u32 = 20;

#[divan::bench(args = [(true, 1), (true, 2), (false, 1)], sample_count = 5, sample_size = 1)]
fn spot_20_layers(bencher: divan::Bencher<'_, '_>, (convolution, threads): (bool, usize)) {
    let Some((header, source)) = spot::lattice(convolution, |point| point) else { return };
    let points = point_count(&mut contours(&header, &source, 1));
    bencher
        .counter(divan::counter::ItemsCount::new(points))
        .with_inputs(|| contours(&header, &source, threads))
        .bench_local_refs(point_count);
}

/// Shares of the steps, on one thread.
fn print_steps(convolution: bool) {
    let Some((header, source)) = spot::lattice(convolution, |point| point) else { return };
    let mut contours = contours(&header, &source, 1);
    let before = contours.times();
    let points = point_count(&mut contours);
    let times = contours.times();
    println!("convolution: {convolution}; {points} points of {LAYERS} layers\nstep | ms a layer | points a second");
    for (step, time) in [
        ("field", times.field - before.field),
        ("march", times.march - before.march),
        ("join", times.join - before.join),
        ("simplify", times.simplify - before.simplify),
    ] {
        let seconds = time.as_secs_f64();
        println!("{step} | {:.2} | {:.0}", seconds * 1e3 / f64::from(LAYERS), points as f64 / seconds);
    }
}

/// Contours ready for the layer at [`Z_UM`]: the first layer of a sweep reads all chunks within reach, and a print does so once.
fn contours(header: &Header, source: &MemoryStruts, threads: usize) -> Contours {
    let raster = Raster {
        width_px: 2200,
        height_px: 3600,
        pixel_um: [PITCH_UM; 2],
        build_height_um: 100_000.0,
        mirror: Mirror::default(),
    };
    let plan = SlicePlan::new(header, raster, Depth::Bit, PITCH_UM).expect("it fits");
    let first = (Z_UM / PITCH_UM) as u32 - 1;
    let bodies = vec![BodySource::Lattice(Box::new(source.clone()))];
    let mut contours = Contours::new(bodies, plan, 5.0, threads, first, &MemoryBudget::new(1 << 30)).expect("fits");
    contours.next_layer().expect("a layer");
    contours
}

/// Points of the next [`LAYERS`] layers.
fn point_count(contours: &mut Contours) -> usize {
    let mut count = 0;
    for _ in 0..LAYERS {
        let layer = contours.next_layer().expect("a layer").expect("a layer");
        count += layer.regions().iter().flat_map(Region::rings).map(Vec::len).sum::<usize>();
    }
    count
}
