//! Milliseconds a layer of a real lattice: `spot_lattice.txt` turned to lie on a 3840 × 2160 raster of 20 µm pixels.
//!
//! divan's time is for 200 layers in runs spread over the whole part: a 200th of it is a layer's average. Items are layers.
//! Looks for the file in `$LAYERD_DATA`, default `../shared/data`; without it there is nothing to measure.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use layerd::buildfile::{Blend, BodyHeader, Bounds, Caps, Header, Lattice, Placement, Strut};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, MemoryStruts, SlicePlan, Slicer};
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
    let Some((header, source)) = spot(convolution) else {
        eprintln!("skipped: spot_lattice.txt is not there");
        return;
    };
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

fn spot(convolution: bool) -> Option<(Header, MemoryStruts)> {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let directory = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from);
    let text = std::fs::read_to_string(directory.join("spot_lattice.txt")).ok()?;
    let mut bounds = Bounds { min: [i32::MAX; 3], max: [i32::MIN; 3] };
    let mut radius_range = [u32::MAX, 0];
    let mut struts = Vec::new();
    for line in text.lines().skip(1) {
        let [x1, y1, z1, x2, y2, z2, r]: [i32; 7] = line
            .split_whitespace()
            .map(|word| (word.parse::<f64>().expect("a number") * 1000.0).round() as i32)
            .collect::<Vec<_>>()
            .try_into()
            .ok()?;
        // A quarter turn about z: (x, y) → (−y, x).
        let (mut a, mut b) = ([-y1, x1, z1], [-y2, x2, z2]);
        if a[2] > b[2] {
            std::mem::swap(&mut a, &mut b);
        }
        for axis in 0..3 {
            bounds.min[axis] = bounds.min[axis].min(a[axis].min(b[axis]) - r);
            bounds.max[axis] = bounds.max[axis].max(a[axis].max(b[axis]) + r);
        }
        let radius = r.unsigned_abs();
        radius_range = [radius_range[0].min(radius), radius_range[1].max(radius)];
        struts.push(Strut { a, b, radius_a: radius, radius_b: radius, caps: Caps::default() });
    }
    let support_um = 1.5 * f64::from(radius_range[1]);
    let lattice = Lattice {
        blend: if convolution { Blend::Convolution { support_um } } else { Blend::Union },
        bounds,
        radius_range,
        strut_count: struts.len() as u64,
        ball_count: 0,
        node_count: 0,
    };
    let header = Header {
        quantum_um: 1.0,
        bounds,
        bottom_um: f64::from(bounds.min[2]),
        placement: Placement::Centred,
        source_digest: [0; 32],
        source_name: "spot_lattice.txt".into(),
        bodies: vec![BodyHeader::Lattice(lattice.clone())],
    };
    Some((header, MemoryStruts::new(1.0, lattice, struts, 8192)))
}
