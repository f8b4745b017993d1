//! Milliseconds a layer of a real lattice of one material and of several, joined and halftoned: `spot_lattice.txt` at 1080 × 1920 and 3840 × 2160
//! pixels. All cases are measured in turn, and the least time of each counts, so their ratios do not depend on what else the machine does.
//!
//! Looks for the file in `$LAYERD_DATA`, default `../shared/data`; without it there is nothing to measure.

mod cpu_time;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use cpu_time::cpu_time;
use layerd::buildfile::{BuildFile, JointChoice, PackOptions, Split, pack};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, MaskSlicer, MaskSources, SlicePlan, Slicer};
use layerd::stream::MemoryBudget;

const ROUNDS: usize = 5;

/// Runs of layers spread evenly over the whole part, and the layers of a run.
const RUNS: u32 = 10;
const RUN_LAYERS: u32 = 10;

/// What a case is made of: the materials at the ends of strut number n, and how they are joined.
struct Case {
    name: &'static str,
    materials: fn(usize) -> Option<[usize; 2]>,
    is_elliptic: bool,
    split: Split,
}

const CASES: [Case; 6] = [
    Case { name: "one", materials: |_| None, is_elliptic: false, split: Split::Max },
    Case {
        name: "two, every other strut",
        materials: |n| Some([n % 2; 2]),
        is_elliptic: false,
        split: Split::Halftone,
    },
    Case { name: "two, largest share", materials: |n| Some([n % 2; 2]), is_elliptic: false, split: Split::Max },
    Case { name: "two, elliptic", materials: |n| Some([n % 2; 2]), is_elliptic: true, split: Split::Halftone },
    Case { name: "two, all struts graded", materials: |_| Some([0, 1]), is_elliptic: false, split: Split::Halftone },
    Case {
        name: "four, every fourth strut",
        materials: |n| Some([n % 4; 2]),
        is_elliptic: false,
        split: Split::Halftone,
    },
];

fn main() {
    let default = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let data = std::env::var_os("LAYERD_DATA").map_or(default, PathBuf::from);
    let Ok(text) = std::fs::read_to_string(data.join("spot_lattice.txt")) else {
        eprintln!("skipped: spot_lattice.txt is not there");
        return;
    };
    let directory = tempfile::tempdir().expect("a directory");
    let files: Vec<_> = CASES.iter().map(|case| packed(case, &text, directory.path())).collect();
    for (width_px, height_px, pixel_um) in [(1920, 1080, 50.0), (3840, 2160, 20.0)] {
        for depth in [Depth::Bit, Depth::Grey] {
            let measured: Vec<f64> = (0..ROUNDS)
                .map(|_| files.iter().map(|file| ms(file, [width_px, height_px], pixel_um, depth)).collect::<Vec<_>>())
                .reduce(|least, round| least.iter().zip(round).map(|(one, other)| one.min(other)).collect())
                .expect("there are rounds");
            println!("{width_px} × {height_px} pixels of {pixel_um} µm, {depth:?}");
            for (case, ms) in CASES.iter().zip(&measured) {
                println!("    {:<26} {ms:6.2} ms a layer, {:.2} times one material", case.name, ms / measured[0]);
            }
        }
    }
}

/// The build file of a case, turned to lie on a wide raster.
fn packed(case: &Case, text: &str, directory: &Path) -> Arc<BuildFile> {
    let mut lines = text.lines();
    let mut source = lines.next().expect("a first line").to_owned() + "\n";
    for (number, line) in lines.enumerate() {
        source += line;
        if let Some([a, b]) = (case.materials)(number) {
            source += &format!(" m{a} m{b}");
        }
        source += "\n";
    }
    let (input, output) = (directory.join("in.txt"), directory.join(format!("{}.layerd", case.name)));
    std::fs::write(&input, source).expect("there is room");
    let joint = match case.is_elliptic {
        true => JointChoice::elliptic(None, 20.0, None).expect("in range"),
        false => JointChoice::Convolution { support_mm: None },
    };
    let options =
        PackOptions { joint: Some(joint), split: case.split, rotate_deg: [0.0, 0.0, 90.0], ..PackOptions::default() };
    pack(&[input], &output, &options, &mut |_| {}).expect("is packed");
    Arc::new(BuildFile::open(&output).expect("is whole"))
}

/// Processor time of a layer on one thread, milliseconds.
fn ms(file: &Arc<BuildFile>, [width_px, height_px]: [u32; 2], pixel_um: f64, depth: Depth) -> f64 {
    let raster =
        Raster { width_px, height_px, pixel_um: [pixel_um; 2], build_height_um: 1e6, mirror: Mirror::default() };
    let plan = SlicePlan::new(file.header(), raster, depth, pixel_um).expect("it fits turned");
    let budget = MemoryBudget::new(1 << 30);
    let mut total = 0.0;
    for run in 0..RUNS {
        // The first layer of a sweep reads all chunks within reach; a print does so once.
        let first = plan.layer_count * (2 * run + 1) / (2 * RUNS) - 1;
        let mut draw = drawing(file, &plan, first, &budget);
        draw();
        let began = cpu_time();
        (0..RUN_LAYERS).for_each(|_| draw());
        total += (cpu_time() - began).as_secs_f64();
    }
    total * 1000.0 / f64::from(RUNS * RUN_LAYERS)
}

/// Draws the next layer, or its masks.
fn drawing(file: &Arc<BuildFile>, plan: &SlicePlan, first: u32, budget: &MemoryBudget) -> Box<dyn FnMut()> {
    if file.header().materials.is_none() {
        let mut bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, plan.depth);
        let mut slicer = Slicer::new(BodySource::of(file), plan.clone(), 1, first, budget).expect("fits");
        return Box::new(move || assert!(slicer.next_layer(&mut bitmap).expect("a layer").is_some()));
    }
    let mut slicer = MaskSlicer::new(MaskSources::of(file), plan.clone(), 1, first, budget).expect("fits");
    let mut masks = slicer.dark_masks();
    Box::new(move || assert!(slicer.next_layer(&mut masks).expect("a layer").is_some()))
}
