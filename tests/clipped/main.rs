//! Lattices that a surface clips: layers against those of lattice and surface alone, where they begin, and 3MF that states it.

mod bottoms;
#[path = "../meshes/box_mesh.rs"]
mod box_mesh;
mod layers;
#[path = "../pack_bench/mod.rs"]
mod pack_bench;
#[path = "../properties/mod.rs"]
mod properties;
mod regions;
#[path = "../surface/shapes.rs"]
mod shapes;
#[path = "../slice_part/mod.rs"]
mod slice_part;
mod stored;
mod three_mf;

use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use layerd::buildfile::{
    BodySettings, BuildFile, Caps, Header, Joint, Keeps, Lattice, Placement, Shares, Strut, Surface, Triangle,
    WriteError, Writer, WriterSettings,
};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, MemoryStruts, MemoryTriangles, SlicePlan};
use shapes::Mesh;
use slice_part::sliced;

const PIXEL_UM: [f64; 2] = [20.0, 24.0];

/// A lattice, and what clips it.
struct Clipped {
    struts: Vec<Strut>,
    joint: Joint,
    keeps: Keeps,
    triangles: Vec<Triangle>,
}

impl Clipped {
    fn new(struts: &[Strut], joint: Joint, keeps: Keeps, mesh: &Mesh) -> Self {
        let upwards = |strut: &Strut| {
            let Strut { a, b, radius_a, radius_b, caps, .. } = *strut;
            let key = |[x, y, z]: [i32; 3]| [z, y, x];
            if key(a) <= key(b) {
                return *strut;
            }
            Strut {
                a: b,
                b: a,
                radius_a: radius_b,
                radius_b: radius_a,
                caps: Caps { a: caps.b, b: caps.a },
                shares: Shares::default(),
            }
        };
        let mut struts: Vec<_> = struts.iter().map(upwards).collect();
        struts.sort_by_key(|strut| [strut.a, strut.b].map(|[x, y, z]| [z, y, x]));
        let mut triangles: Vec<_> = mesh.triangles().collect();
        triangles.sort_by_key(|triangle| triangle.corners.map(|[x, y, z]| [z, y, x]));
        Self { struts, joint, keeps, triangles }
    }

    /// Writes it, at a quantum of 1 µm.
    fn write(&self, path: &Path) -> Result<Header, WriteError> {
        let radii = self.struts.iter().flat_map(|strut| [strut.radius_a, strut.radius_b]);
        let largest_radius = radii.max().expect("struts");
        let settings = WriterSettings {
            materials: None,
            quantum_um: 1.0,
            placement: Placement::Centred,
            source_digest: [0; 32],
            source_name: "test".into(),
            bodies: vec![
                BodySettings::Lattice { joint: self.joint, largest_radius },
                BodySettings::Clip { keeps: self.keeps },
            ],
        };
        let mut writer = Writer::create(path, settings)?;
        self.struts.iter().try_for_each(|strut| writer.push(*strut))?;
        writer.next_body()?;
        self.triangles.iter().try_for_each(|triangle| writer.push_triangle(*triangle))?;
        writer.finish()
    }

    /// Written and opened; `None` if nothing is left.
    fn packed(&self) -> Option<Packed> {
        let directory = tempfile::tempdir().expect("temporary directory");
        let path = directory.path().join("part.layerd");
        let header = match self.write(&path) {
            Ok(header) => header,
            Err(WriteError::NothingLeft { body: 1, .. }) => {
                assert!(!path.exists(), "no file stays behind");
                return None;
            }
            Err(error) => panic!("{error}"),
        };
        let file = BuildFile::open(&path).expect("what is written is whole");
        file.verify().expect("it agrees with itself");
        assert_eq!(&header, file.header());
        Some(Packed { file: Arc::new(file), _directory: directory })
    }

    /// The lattice and the surface, each alone.
    fn alone(&self) -> [Vec<BodySource>; 2] {
        let lattice: Lattice = slice_part::lattice(&slice_part::header(&self.struts, self.joint));
        let surface = Surface::of(&self.triangles);
        [
            vec![BodySource::Lattice(Box::new(MemoryStruts::new(1.0, lattice, self.struts.clone(), 5)))],
            vec![BodySource::Surface(Box::new(MemoryTriangles::new(1.0, surface, self.triangles.clone(), 7)))],
        ]
    }
}

/// A build file.
struct Packed {
    file: Arc<BuildFile>,
    _directory: tempfile::TempDir,
}

impl Packed {
    fn header(&self) -> &Header {
        self.file.header()
    }

    fn plan(&self, depth: Depth, mirror: Mirror, layer_height_um: f64) -> SlicePlan {
        let bounds = self.header().bounds;
        let pixels = |axis: usize| (f64::from(bounds.max[axis] - bounds.min[axis]) / PIXEL_UM[axis]) as u32 + 24;
        let (width_px, height_px) = (pixels(0), pixels(1));
        let raster = Raster { width_px, height_px, pixel_um: PIXEL_UM, build_height_um: 50_000.0, mirror };
        SlicePlan::new(self.header(), raster, depth, layer_height_um).expect("it fits")
    }

    fn layers(&self, plan: &SlicePlan, threads: usize, first: u32) -> Vec<Bitmap> {
        sliced(|| BodySource::of(&self.file), plan, threads, first)
    }
}

fn is_lit(bitmap: &Bitmap) -> bool {
    bitmap.data().iter().any(|byte| *byte != 0)
}

/// The middle of the raster's struts, which is where meshes are put.
const MIDDLE: DVec3 = DVec3::new(800.0, 600.0, 150.0);
