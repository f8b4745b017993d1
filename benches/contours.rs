//! Contours of `spot_lattice.txt` at z = 30 mm, on pixels of 30 µm: points a second for each step. `cargo bench --bench contours`
//!
//! divan's time is for 20 layers. Items are points after simplification, which are the vectors of a contour. The table below it divides
//! the time of the threads among the steps. Looks for the file in `$LAYERD_DATA`, default `../shared/data`; without it there is nothing
//! to measure.

mod scan_steps;
mod spot_contours;

use layerd::buildfile::Header;
use layerd::slice::MemoryStruts;
use layerd::slice::scan::{Contours, Region};
use layerd::stream::MemoryBudget;
use scan_steps::{contour_steps, print_step};
use spot_contours::LAYERS;

fn main() {
    divan::main();
    print_steps(true);
    print_steps(false);
}

#[divan::bench(args = [(true, 1), (true, 2), (false, 1)], sample_count = 5, sample_size = 1)]
fn spot_20_layers(bencher: divan::Bencher<'_, '_>, (convolution, threads): (bool, usize)) {
    let Some((header, source)) = spot_contours::lattice(convolution) else { return };
    let points = point_count(&mut contours(&header, &source, 1));
    bencher
        .counter(divan::counter::ItemsCount::new(points))
        .with_inputs(|| contours(&header, &source, threads))
        .bench_local_refs(point_count);
}

/// Shares of the steps, on one thread.
fn print_steps(convolution: bool) {
    let Some((header, source)) = spot_contours::lattice(convolution) else { return };
    let mut contours = contours(&header, &source, 1);
    let before = contours.times();
    let points = point_count(&mut contours);
    let times = contours.times();
    println!("convolution: {convolution}; {points} points of {LAYERS} layers\nstep | ms a layer | points a second");
    for (step, time) in contour_steps(before, times) {
        print_step(step, time, LAYERS, points as u64);
    }
}

fn contours(header: &Header, source: &MemoryStruts, threads: usize) -> Contours {
    spot_contours::contours(header, source, 5.0, threads, &MemoryBudget::new(1 << 30))
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
