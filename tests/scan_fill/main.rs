//! Filled regions: what is covered, what is spilled, and what lies where.

mod cover;
mod hatches;
mod measure;
mod order;
#[path = "../properties/mod.rs"]
mod properties;
mod refused;
#[path = "../scan_samples/mod.rs"]
mod scan_samples;
mod thin;

use layerd::layer::{MarkClass, Vectors};
use layerd::slice::scan::{Fill, HatchStrategy, Neighbours, Region, ScanCounts, ScanSettings};
use layerd::stream::MemoryBudget;
use scan_samples::{disc, rectangle, with_hole};

const STRATEGIES: [HatchStrategy; 4] = [
    HatchStrategy::Zigzag,
    HatchStrategy::Unidirectional,
    HatchStrategy::Stripes { width_um: 700.0, overlap_um: 50.0 },
    HatchStrategy::Chessboard { island_um: 600.0, overlap_um: 50.0 },
];

/// Enough for every layer here.
fn budget() -> MemoryBudget {
    MemoryBudget::new(1 << 30)
}

fn filled(settings: &ScanSettings, layer: u32, regions: &[Region]) -> (Vectors, ScanCounts) {
    let mut vectors = Vectors::default();
    let mut fill = Fill::new(settings.clone(), 1, &budget()).expect("good settings");
    let counts = fill.layer(layer, regions, Neighbours::default(), &mut vectors).expect("it lies in the field");
    (vectors, counts)
}

fn class_count(vectors: &Vectors, class: MarkClass) -> usize {
    vectors.marks().filter(|mark| mark.class == class).count()
}

fn plate() -> Region {
    let plate = rectangle([1000.0, 1000.0], [5000.0, 3500.0]);
    let plate = with_hole(plate, disc([2000.0, 2000.0], 400.0));
    with_hole(plate, rectangle([3000.0, 1500.0], [4200.0, 2900.0]))
}
