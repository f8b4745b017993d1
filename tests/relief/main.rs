//! Surfaces with relief: displaced, curved and shell triangles, from the source to the layers, against formulas.

mod bad_input;
mod curved;
mod displaced;
mod exact;
mod field;
mod materials;
mod near;
mod objects;
#[path = "../pack_bench/mod.rs"]
mod pack_bench;
mod points;
mod shells;
#[path = "../skip/mod.rs"]
mod skip;
#[path = "../slice_part/mod.rs"]
mod slice_part;
mod stored;
mod three_mf;

use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec3;
use layerd::buildfile::{BuildFile, DisplacementOptions, PackError, PackReport, Tile, pack};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, SlicePlan};
use objects::Object;
use pack_bench::Bench;
use slice_part::{lit, sliced};

/// A printer: pixels of 50 × 40 µm, layers of 30 µm.
const PIXEL_UM: [f64; 2] = [50.0, 40.0];
const LAYER_UM: f64 = 30.0;

/// A height map of values from 0 to 1, as a function of texture coordinates from the lower left.
fn map(size: [u32; 2], value: impl Fn([f64; 2]) -> f64) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let texels =
        (0..size[1]).flat_map(|row| (0..size[0]).map(move |column| (row, column))).flat_map(|(row, column)| {
            let u = (f64::from(column) + 0.5) / f64::from(size[0]);
            let v = 1.0 - (f64::from(row) + 0.5) / f64::from(size[1]);
            ((value([u, v]) * 65_535.0).round() as u16).to_be_bytes()
        });
    let texels: Vec<u8> = texels.collect();
    encoder.write_header().expect("a head").write_image_data(&texels).expect("texels");
    bytes
}

/// A part that was packed.
struct Part {
    /// It holds the build file.
    _bench: Bench,
    file: Arc<BuildFile>,
    report: PackReport,
}

/// What is done to an object.
struct Recipe<'a> {
    map: Option<&'a [u8]>,
    tile: Tile,
    height_mm: f64,
    offset_mm: f64,
    is_curved: bool,
    shell_mm: Option<f64>,
    rotate_deg: [f64; 3],
    scale: [f64; 3],
}

const PLAIN: Recipe<'_> = Recipe {
    map: None,
    tile: Tile::Wrap,
    height_mm: 1.0,
    offset_mm: 0.0,
    is_curved: false,
    shell_mm: None,
    rotate_deg: [0.0; 3],
    scale: [1.0; 3],
};

/// Packs OBJ as a recipe says.
fn packed(bench: &mut Bench, text: &str, recipe: &Recipe<'_>) -> Result<PackReport, PackError> {
    let source = bench.file("in.obj", text.as_bytes());
    let relief = &mut bench.options.relief;
    relief.is_curved = recipe.is_curved;
    relief.shell_mm = recipe.shell_mm;
    if let Some(map) = recipe.map {
        let path: PathBuf = bench.directory.path().join("map.png");
        std::fs::write(&path, map).expect("can be written");
        relief.map = Some(DisplacementOptions { map: path, tile: recipe.tile });
        (relief.height_mm, relief.offset_mm) = (Some(recipe.height_mm), Some(recipe.offset_mm));
    }
    bench.options.rotate_deg = recipe.rotate_deg;
    bench.options.scale = recipe.scale;
    pack(&[source], &bench.path("out.layerd"), &bench.options, &mut |_| {})
}

impl Part {
    fn new(object: &Object, recipe: &Recipe<'_>) -> Self {
        let mut bench = Bench::new();
        let report = packed(&mut bench, &object.obj(), recipe).unwrap_or_else(|error| panic!("{error}"));
        let file = BuildFile::open(&bench.path("out.layerd")).expect("what pack writes is whole");
        file.verify().expect("it agrees with itself");
        Self { _bench: bench, file: Arc::new(file), report }
    }

    fn plan(&self, depth: Depth) -> SlicePlan {
        self.plan_of(depth, PIXEL_UM, LAYER_UM)
    }

    fn plan_of(&self, depth: Depth, pixel_um: [f64; 2], layer_um: f64) -> SlicePlan {
        let bounds = self.file.header().bounds;
        let pixels = |axis: usize| (f64::from(bounds.max[axis] - bounds.min[axis]) / pixel_um[axis]) as u32 + 24;
        let raster = Raster {
            width_px: pixels(0),
            height_px: pixels(1),
            pixel_um,
            build_height_um: 500_000.0,
            mirror: Mirror::default(),
        };
        SlicePlan::new(self.file.header(), raster, depth, layer_um).expect("it fits")
    }

    fn layers(&self, plan: &SlicePlan, threads: usize, first: u32) -> Vec<Bitmap> {
        sliced(|| BodySource::of(&self.file), plan, threads, first)
    }

    /// Compares each pixel of each layer with `inside`, which returns by how many millimetres a point lies inside, about. Returns the
    /// farthest distance of a pixel that lies on the wrong side, millimetres.
    fn farthest_mm(&self, plan: &SlicePlan, inside: impl Fn(DVec3) -> f64) -> f64 {
        let (mut farthest, mut lit_count) = (0.0_f64, 0_u64);
        for (number, bitmap) in self.layers(plan, 2, 0).iter().enumerate() {
            for (x, y) in pixels(plan) {
                let is_lit = lit(bitmap, x, y);
                lit_count += u64::from(is_lit);
                let excess_mm = inside(point_mm(plan, x, y, number));
                if is_lit != (excess_mm > 0.0) {
                    farthest = farthest.max(excess_mm.abs());
                }
            }
        }
        assert!(lit_count > 0, "nothing was drawn");
        farthest
    }

    /// The volume that the layers fill, mm³.
    fn volume_mm3(&self, plan: &SlicePlan) -> f64 {
        let layers = self.layers(plan, 2, 0);
        let count: usize = layers.iter().map(|bitmap| pixels(plan).filter(|(x, y)| lit(bitmap, *x, *y)).count()).sum();
        let [dx, dy] = plan.raster.pixel_um;
        count as f64 * dx * dy * plan.layer_height_um / 1e9
    }
}

fn pixels(plan: &SlicePlan) -> impl Iterator<Item = (u32, u32)> + use<> {
    let (width, height) = (plan.raster.width_px, plan.raster.height_px);
    (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)))
}

/// The centre of a pixel in the middle of a layer, millimetres.
fn point_mm(plan: &SlicePlan, x: u32, y: u32, layer: usize) -> DVec3 {
    let ([dx, dy], [x0, y0]) = (plan.step_um(), plan.origin_um);
    DVec3::new(x0 + f64::from(x) * dx, y0 + f64::from(y) * dy, plan.layer_z_um(layer as u32)) / 1000.0
}
