//! Regions of each material, for a laser, against the formulas.

use std::sync::Arc;

use layerd::buildfile::{BuildFile, JointChoice, Shares, Strut};
use layerd::layer::{Depth, Mirror, Raster};
use layerd::slice::scan::{Contours, Region};
use layerd::slice::{BodySource, FieldSource, SlicePlan};
use layerd::solid::reference::{elliptic, shared_beam_field};
use layerd::stream::MemoryBudget;

use crate::pack_bench::Bench;
use crate::slice_part::beam;

/// Three materials that meet in a node and pass into each other, and a strut apart.
const TEXT: &str =
    "5 0.5 0 0\n0 0 0 2 1 4 0.5 a\n0 3 0 2 1 4 0.4 b c\n2 1 4 4 2 8 0.5 c\n2 1 4 0 2 8 0.6 a b\n5 0 0 5 3 8 0.4 b\n";

/// Whether a point lies in any of the regions: rings around it are counted.
fn contains(regions: &[Region], [x, y]: [f64; 2]) -> bool {
    let mut inside = false;
    for ring in regions.iter().flat_map(Region::rings) {
        for at in 0..ring.len() {
            let ([x1, y1], [x2, y2]) = (ring[at], ring[(at + 1) % ring.len()]);
            if (y1 > y) != (y2 > y) && x < x1 + (y - y1) / (y2 - y1) * (x2 - x1) {
                inside = !inside;
            }
        }
    }
    inside
}

/// The regions of all layers.
fn layers(sources: impl Fn() -> Vec<FieldSource>, plan: &SlicePlan) -> Vec<Vec<Region>> {
    let memory = Contours::memory_bytes_of_sources(&sources(), plan, 1);
    let budget = MemoryBudget::new(memory + (16 << 20));
    let mut contours = Contours::of_sources(sources(), plan.clone(), 0.0, 1, 0, &budget).expect("contours");
    assert_eq!(budget.used_bytes(), memory, "what was stated is charged");
    let mut layers = Vec::new();
    while let Some(layer) = contours.next_layer().expect("a layer") {
        layers.push(layer.regions().to_vec());
    }
    layers
}

fn plan(file: &BuildFile) -> SlicePlan {
    let raster = Raster {
        width_px: 180,
        height_px: 140,
        pixel_um: [40.0, 44.0],
        build_height_um: 50_000.0,
        mirror: Mirror::default(),
    };
    SlicePlan::new(file.header(), raster, Depth::Bit, 700.0).expect("it fits")
}

#[test]
fn each_material_has_the_regions_where_its_field_is_the_greatest() {
    for joint in
        [JointChoice::Convolution { support_mm: None }, JointChoice::elliptic(None, 15.0, None).expect("in range")]
    {
        let mut bench = Bench::new();
        bench.options.joint = Some(joint);
        let (report, _) = bench.text(TEXT).expect("is packed");
        let file = Arc::new(BuildFile::open(&bench.path("out.layerd")).expect("is whole"));
        let plan = plan(&file);
        let struts = |body: usize| -> Vec<Strut> {
            let mut struts = Vec::new();
            file.body_chunks(body).for_each(|chunk| file.read_chunk(chunk, &mut struts).expect("is whole"));
            struts
        };
        let of_materials: Vec<_> = (0..3).map(struts).collect();
        let joint = report.header.lattices().next().expect("it has one").joint;
        let support_um = joint.support_um().expect("a convolution");
        let whole = layers(|| BodySource::of(&file).into_iter().map(FieldSource::Whole).collect(), &plan);
        let parts: Vec<_> = (0..3)
            .map(|material| layers(|| FieldSource::of_material(&file, material).expect("a convolution"), &plan))
            .collect();
        let mut seen = [0; 3];
        for layer in 0..whole.len() {
            for (x, y) in (0..140).flat_map(|y| (0..180).map(move |x| (x, y))) {
                let field_um = [(f64::from(x) + 0.5) * 40.0, (f64::from(y) + 0.5) * 44.0];
                let p = [
                    plan.origin_um[0] + f64::from(x) * 40.0,
                    plan.origin_um[1] + f64::from(y) * 44.0,
                    plan.layer_z_um(layer as u32),
                ];
                let field = |struts: &Vec<Strut>| -> f64 {
                    let share = |share: u16| f64::from(share) / f64::from(Shares::WHOLE);
                    let of_strut = |strut: &Strut| {
                        let shares = [share(strut.shares.a), share(strut.shares.b)];
                        shared_beam_field(&beam(strut), shares, support_um, p)
                    };
                    struts.iter().map(of_strut).sum()
                };
                let fields: Vec<f64> = of_materials.iter().map(field).collect();
                let joined = match joint {
                    layerd::buildfile::Joint::Elliptic { least, .. } => elliptic(&fields, &[least[0]; 3]),
                    _ => fields.iter().sum(),
                };
                for material in 0..3 {
                    let others =
                        (0..3).filter(|other| *other != material).map(|other| fields[other]).fold(0.0, f64::max);
                    let excess = (joined - 1.0).min(fields[material] - others);
                    // A vertex of the grid that is solid by a hair may be cut off.
                    if excess.abs() > 1e-4 {
                        let found = contains(&parts[material][layer], field_um);
                        assert_eq!(found, excess > 0.0, "material {material}, layer {layer}, {field_um:?}: {fields:?}");
                        seen[material] += usize::from(found);
                    }
                }
            }
            let area = |regions: &[Region]| regions.iter().map(Region::area_um2).sum::<f64>();
            let sum: f64 = parts.iter().map(|layers| area(&layers[layer])).sum();
            // Corners of the grid are cut where three meet.
            assert!((sum - area(&whole[layer])).abs() < 0.02 * area(&whole[layer]).max(1e4), "layer {layer}");
        }
        assert!(seen.iter().all(|count| *count > 1000), "{seen:?}");
    }
}

#[test]
fn in_a_union_the_last_material_prevails_and_gradients_are_refused() {
    let bench = Bench::new();
    let text = "2 0.5 0 0\n0 0 2 4 0 2 1 a\n2 -2 2 2 2 2 1 b\n";
    bench.text(text).expect("is packed");
    let file = Arc::new(BuildFile::open(&bench.path("out.layerd")).expect("is whole"));
    let plan = plan(&file);
    let area = |sources: &dyn Fn() -> Vec<FieldSource>| -> f64 {
        layers(sources, &plan)[0].iter().map(Region::area_um2).sum()
    };
    let whole = area(&|| BodySource::of(&file).into_iter().map(FieldSource::Whole).collect());
    let [a, b] = [0, 1].map(|material| area(&|| FieldSource::of_material(&file, material).expect("not graded")));
    assert!((a + b - whole).abs() < 0.005 * whole, "{a} and {b} of {whole}");
    assert!(b > 1.2 * a, "{a}, {b}");

    bench.text(&text.replace("1 b", "1 a b")).expect("is packed");
    let file = Arc::new(BuildFile::open(&bench.path("out.layerd")).expect("is whole"));
    let refused = FieldSource::of_material(&file, 0).err().expect("is refused").to_string();
    assert!(refused.contains("--joint convolution"), "{refused}");
}
