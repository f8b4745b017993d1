//! Milliseconds a layer of a real lattice: `spot_lattice.txt` turned to lie on a 3840 × 2160 raster of 20 µm pixels.
//!
//! Looks for the file in `$LAYERD_DATA`, default `../shared/data`; without it there is nothing to measure.

use std::path::{Path, PathBuf};

use layerd::buildfile::{Blend, Bounds, Caps, Header, Placement, Strut};
use layerd::slice::{Bitmap, Depth, MemoryStruts, Mirror, Raster, SlicePlan, Slicer};
use layerd::stream::MemoryBudget;

fn main() {
    divan::main();
}

/// Layers a sample computes, in the thick of the part; divan's figure is for all of them together.
const LAYERS: u32 = 50;

#[divan::bench(args = [(Depth::Bit, 1), (Depth::Bit, 2), (Depth::Grey, 1)], sample_count = 5, sample_size = 1)]
fn spot_convolution_50_layers(bencher: divan::Bencher<'_, '_>, (depth, threads): (Depth, usize)) {
    bench(bencher, true, depth, threads);
}

#[divan::bench(args = [(Depth::Bit, 1), (Depth::Grey, 1)], sample_count = 5, sample_size = 1)]
fn spot_union_50_layers(bencher: divan::Bencher<'_, '_>, (depth, threads): (Depth, usize)) {
    bench(bencher, false, depth, threads);
}

fn bench(bencher: divan::Bencher<'_, '_>, convolution: bool, depth: Depth, threads: usize) {
    let Some(source) = spot(convolution) else {
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
    let header = layerd::slice::StrutSource::header(&source);
    let plan = SlicePlan::new(header, raster, depth, 20.0).expect("it fits turned");
    let first = plan.layer_count / 2;
    let mut bitmap = Bitmap::new(3840, 2160, depth);
    bencher
        .with_inputs(|| {
            let budget = MemoryBudget::new(1 << 30);
            let mut slicer = Slicer::new(source.clone(), plan.clone(), threads, first, &budget).expect("fits");
            // The first layer of a sweep reads all chunks within reach.
            slicer.next_layer(&mut bitmap).expect("a layer");
            slicer
        })
        .bench_local_refs(|slicer| {
            let mut bitmap = Bitmap::new(3840, 2160, depth);
            for _ in 0..LAYERS {
                slicer.next_layer(&mut bitmap).expect("a layer");
            }
            divan::black_box(bitmap);
        });
}

fn spot(convolution: bool) -> Option<MemoryStruts> {
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
    let header = Header {
        quantum_um: 1.0,
        blend: if convolution { Blend::Convolution { support_um } } else { Blend::Union },
        bounds,
        radius_range,
        strut_count: struts.len() as u64,
        ball_count: 0,
        node_count: 0,
        placement: Placement::Centred,
        source_digest: [0; 32],
        source_name: "spot_lattice.txt".into(),
    };
    Some(MemoryStruts::new(header, struts, 8192))
}
