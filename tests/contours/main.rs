//! The regions of layers: against the picture's topology, formulas, and the field of a real lattice.

mod any_lattice;
#[path = "../properties/mod.rs"]
mod properties;
mod rings;
mod shapes;
#[path = "../skip/mod.rs"]
mod skip;
#[path = "../slice_part/mod.rs"]
mod slice_part;
mod spot;
mod topology;

use layerd::slice::scan::{Contours, LayerRegions, Region};
use layerd::slice::{BodySource, FieldSource, SlicePlan};
use layerd::solid::InstructionSet;
use layerd::stream::MemoryBudget;

/// Memory that every layer here fits.
const BUDGET_BYTES: u64 = 256 << 20;

/// How regions are computed.
#[derive(Clone, Copy, Debug)]
struct Way {
    tolerance_um: f64,
    threads: usize,
    first: u32,
    instructions: InstructionSet,
}

impl Way {
    fn with_tolerance(tolerance_um: f64) -> Self {
        Self { tolerance_um, threads: 1, first: 0, instructions: InstructionSet::detect() }
    }
}

/// The regions of all layers.
fn layers(bodies: impl Fn() -> Vec<BodySource>, plan: &SlicePlan, way: Way) -> Vec<Vec<Region>> {
    let Way { tolerance_um, threads, first, instructions } = way;
    let sources = || bodies().into_iter().map(FieldSource::Whole).collect();
    let budget = MemoryBudget::new(BUDGET_BYTES);
    let mut contours =
        Contours::with_instructions(instructions, sources(), plan.clone(), tolerance_um, threads, first, &budget)
            .expect("contours");
    assert_eq!(budget.used_bytes(), Contours::memory_bytes(&bodies(), plan, threads), "what was stated is charged");
    let mut layers = Vec::new();
    while let Some(layer) = contours.next_layer().expect("a layer") {
        assert_eq!(layer.layer() as usize, first as usize + layers.len());
        layers.push(LayerRegions::regions(&layer).to_vec());
    }
    layers
}
