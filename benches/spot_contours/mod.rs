//! Contours of `spot_lattice.txt` on pixels of 30 µm, from z = 30 mm on. `benches/contours.rs`, `benches/scan_fill.rs` and
//! `benches/encoding.rs` use them.

#[path = "../spot/mod.rs"]
mod spot;

use layerd::buildfile::Header;
use layerd::layer::{Depth, Mirror, Raster};
use layerd::slice::scan::Contours;
use layerd::slice::{BodySource, MemoryStruts, SlicePlan};
use layerd::stream::MemoryBudget;

const PIXEL_UM: u32 = 30;
const Z_UM: u32 = 30_000;

/// How many layers are measured.
pub(crate) const LAYERS: u32 = 20;

/// Sides of the field, micrometres.
pub(crate) const FIELD_UM: [u32; 2] = [66_000, 108_000];

/// Header and struts; `None`, and a message, where the file is not there.
pub(crate) fn lattice(convolution: bool) -> Option<(Header, MemoryStruts)> {
    spot::lattice(convolution, |point| point)
}

/// Contours with the layer at z = 30 mm behind them: the first layer of a sweep reads all chunks within reach, and a print does so once.
pub(crate) fn contours(
    header: &Header,
    source: &MemoryStruts,
    tolerance_um: f64,
    threads: usize,
    budget: &MemoryBudget,
) -> Contours {
    let pixel_um = f64::from(PIXEL_UM);
    let raster = Raster {
        width_px: FIELD_UM[0] / PIXEL_UM,
        height_px: FIELD_UM[1] / PIXEL_UM,
        pixel_um: [pixel_um; 2],
        build_height_um: 100_000.0,
        mirror: Mirror::default(),
    };
    let plan = SlicePlan::new(header, raster, Depth::Bit, pixel_um).expect("it fits");
    let bodies = vec![BodySource::Lattice(Box::new(source.clone()))];
    let mut contours =
        Contours::new(bodies, plan, tolerance_um, threads, Z_UM / PIXEL_UM - 1, budget).expect("it fits");
    contours.next_layer().expect("a layer");
    contours
}
