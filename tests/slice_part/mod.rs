//! A part in memory on a small raster, sliced layer after layer.
#![allow(dead_code, unreachable_pub, reason = "each test file uses its part")]

use std::path::Path;
use std::sync::Arc;

use layerd::buildfile::{BodyHeader, Bounds, BuildFile, Cap, Caps, Header, Joint, Lattice, Placement, Shares, Strut};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, MemoryStruts, SlicePlan, Slicer};
use layerd::solid::{Beam, InstructionSet};
use layerd::stream::MemoryBudget;
use proptest::prelude::*;

pub const WIDTH: u32 = 100;
pub const HEIGHT: u32 = 70;
pub const PIXEL_UM: [f64; 2] = [20.0, 24.0];

pub fn raster(mirror: Mirror) -> Raster {
    Raster { width_px: WIDTH, height_px: HEIGHT, pixel_um: PIXEL_UM, build_height_um: 50_000.0, mirror }
}

pub fn strut(a: [i32; 3], b: [i32; 3], radius_a: u32, radius_b: u32) -> Strut {
    let caps = Caps::default();
    if a[2] <= b[2] {
        Strut { a, b, radius_a, radius_b, caps, shares: Shares::default() }
    } else {
        Strut { a: b, b: a, radius_a: radius_b, radius_b: radius_a, caps, shares: Shares::default() }
    }
}

fn node() -> impl Strategy<Value = [i32; 3]> {
    (0..1600_i32, 0..1200_i32, 0..300_i32).prop_map(|(x, y, z)| [x, y, z])
}

/// A strut or ball of any kind within the raster.
pub fn any_strut() -> impl Strategy<Value = Strut> {
    let cap = || prop_oneof![Just(Cap::Sphere), Just(Cap::Hemisphere), Just(Cap::Butt)];
    (node(), node(), 10..120_u32, 10..120_u32, 0..8_u8, cap(), cap()).prop_map(
        |(a, mut b, ra, mut rb, kind, ca, cb)| {
            match kind {
                0 => (b, rb) = (a, ra),           // a ball
                1 => b[2] = a[2],                 // in the layer plane
                2 => (b[1], b[2]) = (a[1], a[2]), // along a row
                3 => b = a.map(|x| x + 3),        // very short
                4 => rb = ra,
                _ => {}
            }
            Strut { caps: Caps { a: ca, b: cb }, ..strut(a, b, ra, rb) }
        },
    )
}

pub fn header(struts: &[Strut], joint: Joint) -> Header {
    let mut bounds = Bounds { min: [i32::MAX; 3], max: [i32::MIN; 3] };
    let mut radius_range = [u32::MAX, 0];
    for strut in struts {
        for (node, radius) in [(strut.a, strut.radius_a), (strut.b, strut.radius_b)] {
            radius_range = [radius_range[0].min(radius), radius_range[1].max(radius)];
            for (axis, at) in node.into_iter().enumerate() {
                bounds.min[axis] = bounds.min[axis].min(at - radius as i32);
                bounds.max[axis] = bounds.max[axis].max(at + radius as i32);
            }
        }
    }
    let strut_count = struts.len() as u64;
    let lattice = Lattice { joint, bounds, radius_range, strut_count, ball_count: 0, node_count: 0, is_graded: false };
    Header {
        materials: None,
        quantum_um: 1.0,
        bounds,
        bottom_um: f64::from(bounds.min[2]),
        placement: Placement::Centred,
        source_digest: [0; 32],
        source_name: String::new(),
        bodies: vec![BodyHeader::Lattice(lattice)],
    }
}

/// The lattice of a part that is one.
pub fn lattice(header: &Header) -> Lattice {
    header.lattices().next().expect("it has one").clone()
}

/// Struts as the one body of a part.
pub fn body(lattice: Lattice, struts: &[Strut], chunk_struts: usize) -> Vec<BodySource> {
    vec![BodySource::Lattice(Box::new(MemoryStruts::new(1.0, lattice, struts.to_vec(), chunk_struts)))]
}

/// A part ready to be sliced.
pub struct Part {
    pub header: Header,
    pub struts: Vec<Strut>,
    pub plan: SlicePlan,
}

impl Part {
    pub fn new(struts: &[Strut], joint: Joint, depth: Depth, mirror: Mirror, layer_height_um: f64) -> Self {
        Self::on(raster(mirror), struts, joint, depth, layer_height_um)
    }

    /// On a raster of [`WIDTH`] by [`HEIGHT`] pixels of another pitch.
    pub fn on(raster: Raster, struts: &[Strut], joint: Joint, depth: Depth, layer_height_um: f64) -> Self {
        let header = header(struts, joint);
        let plan = SlicePlan::new(&header, raster, depth, layer_height_um).expect("it fits");
        Self { header, struts: struts.to_vec(), plan }
    }

    /// Its bodies, in chunks of five struts.
    pub fn bodies(&self) -> Vec<BodySource> {
        body(lattice(&self.header), &self.struts, 5)
    }

    pub fn layers(&self, threads: usize, first: u32) -> Vec<Bitmap> {
        self.layers_with(InstructionSet::detect(), threads, first)
    }

    pub fn layers_with(&self, instructions: InstructionSet, threads: usize, first: u32) -> Vec<Bitmap> {
        let budget = MemoryBudget::new(64 << 20);
        let mut slicer =
            Slicer::with_instructions(instructions, self.bodies(), self.plan.clone(), threads, first, &budget)
                .expect("a slicer");
        assert!(budget.used_bytes() <= Slicer::memory_bytes(&self.bodies(), &self.plan, threads));
        let mut bitmap = Bitmap::new(WIDTH, HEIGHT, self.plan.depth);
        // What the bitmap held must not show through.
        bitmap.data_mut().fill(0xa5);
        let mut layers = Vec::new();
        while let Some(layer) = slicer.next_layer(&mut bitmap).expect("a layer") {
            assert_eq!(layer as usize, first as usize + layers.len());
            layers.push(bitmap.clone());
        }
        layers
    }

    pub fn point(&self, x: u32, y: u32, layer: usize) -> [f64; 3] {
        let [dx, dy] = self.plan.step_um();
        let [x0, y0] = self.plan.origin_um;
        [x0 + f64::from(x) * dx, y0 + f64::from(y) * dy, self.plan.layer_z_um(layer as u32)]
    }
}

/// The layers of bodies from `first` on, in just the memory that they state.
pub fn sliced(bodies: impl Fn() -> Vec<BodySource>, plan: &SlicePlan, threads: usize, first: u32) -> Vec<Bitmap> {
    let memory = Slicer::memory_bytes(&bodies(), plan, threads);
    let budget = MemoryBudget::new(memory);
    let mut slicer = Slicer::new(bodies(), plan.clone(), threads, first, &budget).expect("a slicer");
    assert_eq!(budget.used_bytes(), memory, "what was stated is charged");
    let mut layers = Vec::new();
    let mut bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, plan.depth);
    // What the bitmap held must not show through.
    bitmap.data_mut().fill(0xa5);
    while slicer.next_layer(&mut bitmap).expect("a layer").is_some() {
        layers.push(bitmap.clone());
    }
    layers
}

/// Opens, verifies and draws a build file that may be damaged; says what went wrong first.
///
/// # Errors
/// A text.
pub fn drawn(path: &Path, plan: &SlicePlan) -> Result<(), String> {
    /// A file may state that it needs more, and is refused then.
    const MOST_BYTES: u64 = 1 << 30;
    let file = Arc::new(BuildFile::open(path).map_err(|error| error.to_string())?);
    let verified = file.verify().map_err(|error| error.to_string());
    let bodies = BodySource::of(&file);
    let budget = MemoryBudget::new(Slicer::memory_bytes(&bodies, plan, 1).min(MOST_BYTES));
    // Even of a file that lies.
    let mut slicer = Slicer::new(bodies, plan.clone(), 1, 0, &budget).map_err(|error| error.to_string())?;
    let mut bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, plan.depth);
    while slicer.next_layer(&mut bitmap).map_err(|error| error.to_string())?.is_some() {}
    verified
}

pub fn lit(bitmap: &Bitmap, x: u32, y: u32) -> bool {
    bitmap.data()[y as usize * bitmap.stride_bytes() + x as usize / 8] & (0x80 >> (x % 8)) != 0
}

pub fn beam(strut: &Strut) -> Beam {
    let point = |p: [i32; 3]| p.map(f64::from);
    Beam {
        a: point(strut.a),
        b: point(strut.b),
        radius_a: f64::from(strut.radius_a),
        radius_b: f64::from(strut.radius_b),
        caps: [strut.caps.a, strut.caps.b],
    }
}
