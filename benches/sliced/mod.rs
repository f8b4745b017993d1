//! A part that is sliced as a whole, and tables of such. `benches/surface.rs` and `benches/displaced.rs` use it.

use std::sync::Arc;

use layerd::buildfile::BuildFile;
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, SlicePlan, Slicer};
use layerd::stream::MemoryBudget;

use crate::cpu_time::cpu_time;

/// Each case is measured so often, in turn with the others of its table, and the least time counts: other programs disturb all alike.
const ROUNDS: usize = 7;

/// What is measured: a part on a raster.
pub(crate) struct Case {
    file: Arc<BuildFile>,
    plan: SlicePlan,
    /// Memory of slicing.
    bytes: u64,
}

impl Case {
    /// So many voxels along each side.
    pub(crate) fn new(file: &Arc<BuildFile>, side: u32) -> Self {
        let bounds = file.header().bounds;
        let size_um = [0, 1, 2].map(|axis| f64::from(bounds.max[axis] - bounds.min[axis]));
        let [x_um, y_um, z_um] = size_um.map(|size| size / f64::from(side));
        let raster = Raster {
            width_px: side + 1,
            height_px: side + 1,
            pixel_um: [x_um, y_um],
            build_height_um: size_um[2],
            mirror: Mirror::default(),
        };
        let plan = SlicePlan::new(file.header(), raster, Depth::Bit, z_um).expect("it fits");
        Self::of_plan(file, plan)
    }

    /// Its voxels are those of the picture's pixels, whether the part fills it or not.
    pub(crate) fn of_plan(file: &Arc<BuildFile>, plan: SlicePlan) -> Self {
        let bytes = Slicer::memory_bytes(&BodySource::of(file), &plan, 1);
        Self { file: Arc::clone(file), plan, bytes }
    }

    /// Slices the whole part, and returns the processor time, seconds.
    fn seconds(&self) -> f64 {
        let budget = MemoryBudget::new(self.bytes);
        let mut slicer = Slicer::new(BodySource::of(&self.file), self.plan.clone(), 1, 0, &budget).expect("a slicer");
        let mut bitmap = Bitmap::new(self.plan.raster.width_px, self.plan.raster.height_px, Depth::Bit);
        let began = cpu_time();
        while slicer.next_layer(&mut bitmap).expect("a layer").is_some() {}
        (cpu_time() - began).as_secs_f64()
    }

    fn voxels(&self) -> f64 {
        let Raster { width_px, height_px, .. } = self.plan.raster;
        f64::from(width_px) * f64::from(height_px) * f64::from(self.plan.layer_count)
    }

    fn triangles(&self) -> f64 {
        self.file.chunks().iter().map(|chunk| f64::from(chunk.count)).sum()
    }
}

/// Measures cases and prints a line for each.
pub(crate) fn table(title: &str, cases: &[Case]) {
    let mut seconds = vec![f64::INFINITY; cases.len()];
    for _ in 0..ROUNDS {
        for (seconds, case) in seconds.iter_mut().zip(cases) {
            *seconds = seconds.min(case.seconds());
        }
    }
    println!("\n{title}");
    println!(
        "triangles | Mvoxel | ms a layer | s per Mvoxel | times the first | bytes per voxel | file bytes a triangle | exponent"
    );
    for (number, case) in cases.iter().enumerate() {
        let exponent = number.checked_sub(1).map_or(String::new(), |before| {
            let grown = |size: fn(&Case) -> f64| size(case) / size(&cases[before]);
            let growth = grown(Case::voxels).max(grown(Case::triangles));
            format!("{:.2}", (seconds[number] / seconds[before]).ln() / growth.ln())
        });
        let per_mvoxel = |number: usize| seconds[number] / (cases[number].voxels() / 1e6);
        println!(
            "{} | {:.0} | {:.3} | {:.6} | {:.2} | {:.5} | {:.1} | {exponent}",
            case.triangles(),
            case.voxels() / 1e6,
            seconds[number] * 1000.0 / f64::from(case.plan.layer_count),
            per_mvoxel(number),
            per_mvoxel(number) / per_mvoxel(0),
            case.bytes as f64 / case.voxels(),
            case.file.file_bytes() as f64 / case.triangles(),
        );
    }
}
