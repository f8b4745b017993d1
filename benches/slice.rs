//! Milliseconds a layer of a real lattice: `spot_lattice.txt` turned to lie on a 3840 × 2160 raster of 20 µm pixels.
//!
//! divan's time is for 200 layers in runs spread over the whole part: a 200th of it is a layer's average. Items are layers.
//! Looks for the file in `$LAYERD_DATA`, default `../shared/data`; without it there is nothing to measure.

mod spot;

use std::cell::RefCell;

use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, SlicePlan, Slicer};
use layerd::stream::MemoryBudget;

fn main() {
    divan::main();
}

/// Runs of layers spread evenly over the whole part, and the layers of a run: a fair sample of the part's average.
const RUNS: u32 = 20;
const RUN_LAYERS: u32 = 10;

#[divan::bench(
    args = [(Depth::Bit, 1), (Depth::Bit, 2), (Depth::Grey, 1), (Depth::Grey, 2)],
    sample_count = 5, sample_size = 1
)]
fn spot_convolution_200_layers(bencher: divan::Bencher<'_, '_>, (depth, threads): (Depth, usize)) {
    bench(bencher, true, depth, threads);
}

#[divan::bench(args = [(Depth::Bit, 1), (Depth::Grey, 1)], sample_count = 3, sample_size = 1)]
fn spot_union_200_layers(bencher: divan::Bencher<'_, '_>, (depth, threads): (Depth, usize)) {
    bench(bencher, false, depth, threads);
}

fn bench(bencher: divan::Bencher<'_, '_>, convolution: bool, depth: Depth, threads: usize) {
    // A quarter turn about z: (x, y) → (−y, x).
    let Some((header, source)) = spot::lattice(convolution, |[x, y, z]| [-y, x, z]) else { return };
    let raster = Raster {
        width_px: 3840,
        height_px: 2160,
        pixel_um: [20.0; 2],
        build_height_um: 100_000.0,
        mirror: Mirror::default(),
    };
    let plan = SlicePlan::new(&header, raster, depth, 20.0).expect("it fits turned");
    let bitmap = RefCell::new(Bitmap::new(3840, 2160, depth));
    let begin = |run: u32| {
        // The first layer of a sweep reads all chunks within reach; a print does so once.
        let first = plan.layer_count * (2 * run + 1) / (2 * RUNS) - 1;
        let budget = MemoryBudget::new(1 << 30);
        let mut slicer =
            Slicer::new(vec![BodySource::Lattice(Box::new(source.clone()))], plan.clone(), threads, first, &budget)
                .expect("fits");
        slicer.next_layer(&mut bitmap.borrow_mut()).expect("a layer");
        slicer
    };
    bencher
        .counter(divan::counter::ItemsCount::new(RUNS * RUN_LAYERS))
        .with_inputs(|| (0..RUNS).map(begin).collect::<Vec<_>>())
        .bench_local_refs(|slicers| {
            for slicer in slicers {
                for _ in 0..RUN_LAYERS {
                    slicer.next_layer(&mut bitmap.borrow_mut()).expect("a layer");
                }
            }
        });
}
