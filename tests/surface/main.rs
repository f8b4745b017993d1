//! Surfaces: layers of solids that triangles enclose, against formulas.

mod bits;
#[path = "../meshes/box_mesh.rs"]
mod box_mesh;
mod inspected;
mod near;
#[path = "../properties/mod.rs"]
mod properties;
mod regions;
mod shapes;
#[path = "../slice_part/mod.rs"]
mod slice_part;

use layerd::buildfile::{BodyHeader, Header, Placement, Surface, Triangle};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, MemoryTriangles, SlicePlan};
use shapes::Mesh;
use slice_part::{lit, sliced};

const WIDTH: u32 = 120;
const HEIGHT: u32 = 90;
const PIXEL_UM: [f64; 2] = [20.0, 24.0];

/// A mesh ready to be sliced, placed so that its coordinates are those of the picture: the corner of the picture is at 0, 0.
struct Part {
    triangles: Vec<Triangle>,
    plan: SlicePlan,
}

impl Part {
    fn new(mesh: &Mesh, depth: Depth, mirror: Mirror, layer_height_um: f64) -> Self {
        let triangles: Vec<_> = mesh.triangles().collect();
        let surface = Surface::of(&triangles);
        let bounds = surface.bounds;
        let header = Header {
            materials: None,
            quantum_um: 1.0,
            bounds,
            bottom_um: mesh.lowest_um(),
            placement: Placement::At {
                x_mm: (f64::from(bounds.min[0]) + f64::from(bounds.max[0])) / 2000.0,
                y_mm: (f64::from(bounds.min[1]) + f64::from(bounds.max[1])) / 2000.0,
            },
            source_digest: [0; 32],
            source_name: String::new(),
            bodies: vec![BodyHeader::Surface(surface)],
        };
        let raster =
            Raster { width_px: WIDTH, height_px: HEIGHT, pixel_um: PIXEL_UM, build_height_um: 50_000.0, mirror };
        let plan = SlicePlan::new(&header, raster, depth, layer_height_um).expect("it fits");
        Self { triangles, plan }
    }

    fn bodies(&self) -> Vec<BodySource> {
        vec![BodySource::Surface(Box::new(MemoryTriangles::new(
            1.0,
            Surface::of(&self.triangles),
            self.triangles.clone(),
            7,
        )))]
    }

    /// All layers from `first` on.
    fn layers(&self, threads: usize, first: u32) -> Vec<Bitmap> {
        sliced(|| self.bodies(), &self.plan, threads, first)
    }

    /// The centre of a pixel in the middle of a layer, micrometres.
    fn point(&self, x: u32, y: u32, layer: usize) -> [f64; 3] {
        let [dx, dy] = self.plan.step_um();
        let [x0, y0] = self.plan.origin_um;
        [x0 + f64::from(x) * dx, y0 + f64::from(y) * dy, self.plan.layer_z_um(layer as u32)]
    }

    /// Compares each pixel of each layer with `inside`, which returns by how much a point lies inside, micrometres.
    fn assert_solid(&self, inside: impl Fn([f64; 3]) -> f64) {
        let layers = self.layers(1, 0);
        let mut lit_count = 0;
        for (layer, bitmap) in layers.iter().enumerate() {
            for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
                let excess_um = inside(self.point(x, y, layer));
                let is_lit = lit(bitmap, x, y);
                lit_count += u32::from(is_lit);
                assert!(
                    is_lit == (excess_um > 0.0) || excess_um.abs() < 1e-6,
                    "layer {layer}, pixel {x}, {y}: {excess_um} µm inside"
                );
            }
        }
        assert!(lit_count > 0, "nothing was drawn");
    }
}

const UPRIGHT: Mirror = Mirror { x: false, y: false };
