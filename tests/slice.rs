//! Layers from memory: the exact union, discs and grey, and all that must not change a layer. `exact.rs` has the convolution.

mod properties;
mod slice_part;

use std::sync::Arc;

use layerd::buildfile::{
    BodySettings, Bounds, BuildFile, Cap, Header, Joint, Lattice, Placement, Strut, Writer, WriterSettings,
};
use layerd::layer::{Bitmap, Depth, Mirror, Raster};
use layerd::slice::{BodySource, Footing, MemoryStruts, PlanError, SliceError, SlicePlan, Slicer};
use layerd::solid::{Beam, InstructionSet};
use layerd::stream::MemoryBudget;
use proptest::prelude::*;
use slice_part::{HEIGHT, PIXEL_UM, Part, WIDTH, any_strut, beam, body, header, lattice, lit, raster, strut};

const SUPPORT_UM: f64 = 150.0;
const CONVOLUTION: Joint = Joint::Convolution { support_um: SUPPORT_UM };

/// Exactly: is `p` in the beam? And by how much, for points too near the surface to decide.
fn union_excess(strut: &Strut, p: [f64; 3]) -> f64 {
    let Beam { a, b, radius_a, radius_b, .. } = beam(strut);
    let (a, b, p) = (glam::DVec3::from(a), glam::DVec3::from(b), glam::DVec3::from(p));
    if a == b {
        return radius_a - p.distance(a);
    }
    let (u, length) = ((b - a).normalize(), a.distance(b));
    let t = (p - a).dot(u);
    let away = (p - a - t * u).length();
    let body = (radius_a + (radius_b - radius_a) * t / length - away).min(t).min(length - t);
    let cap = |cap, centre, radius: f64, beyond: f64| match cap {
        Cap::Sphere => radius - p.distance(centre),
        Cap::Hemisphere => (radius - p.distance(centre)).min(beyond),
        Cap::Butt => f64::NEG_INFINITY,
    };
    body.max(cap(strut.caps.a, a, radius_a, -t)).max(cap(strut.caps.b, b, radius_b, t - length))
}

proptest! {
    #![proptest_config(properties::cases(12))]

    #[test]
    fn a_union_is_exact(struts in prop::collection::vec(any_strut(), 1..10)) {
        let part = Part::new(&struts, Joint::Union, Depth::Bit, Mirror { x: true, y: false }, 60.0);
        for (layer, bitmap) in part.layers(2, 0).iter().enumerate() {
            for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
                let p = part.point(x, y, layer);
                let excess = struts.iter().map(|strut| union_excess(strut, p)).fold(f64::NEG_INFINITY, f64::max);
                // Where a ball and a body meet in a node's plane both sides count as inside.
                let agrees = lit(bitmap, x, y) == (excess >= 0.0) || excess.abs() < 1e-6;
                prop_assert!(agrees, "layer {layer}, pixel {x}, {y}: {excess} µm inside");
            }
        }
    }

    #[test]
    fn neither_threads_nor_the_start_nor_the_instruction_set_change_a_layer(
        struts in prop::collection::vec(any_strut(), 1..40), union in any::<bool>(), grey in any::<bool>(), start in 1..4_u32,
    ) {
        let joint = if union { Joint::Union } else { CONVOLUTION };
        let depth = if grey { Depth::Grey } else { Depth::Bit };
        let part = Part::new(&struts, joint, depth, Mirror::default(), 40.0);
        let whole = part.layers(1, 0);
        prop_assert_eq!(&part.layers(3, 0), &whole);
        for instructions in InstructionSet::available() {
            prop_assert_eq!(&part.layers_with(instructions, 1, 0), &whole);
        }
        let start = start.min(whole.len() as u32 - 1);
        prop_assert_eq!(&part.layers(2, start)[..], &whole[start as usize..]);
    }

    #[test]
    fn bodies_are_merged_pixel_by_pixel(
        one in prop::collection::vec(any_strut(), 1..12), other in prop::collection::vec(any_strut(), 1..12), grey in any::<bool>(),
    ) {
        let depth = if grey { Depth::Grey } else { Depth::Bit };
        let all = [one.clone(), other.clone()].concat();
        let plan = SlicePlan::new(&header(&all, CONVOLUTION), raster(Mirror::default()), depth, 60.0).expect("it fits");
        let bodies = [(&one, CONVOLUTION), (&other, Joint::Union)]
            .map(|(struts, joint)| (lattice(&header(struts, joint)), struts));
        let layers = |chosen: &[usize], threads| {
            let sources = chosen.iter().flat_map(|at| body(bodies[*at].0.clone(), bodies[*at].1, 5)).collect();
            let mut slicer = Slicer::new(sources, plan.clone(), threads, 0, &MemoryBudget::new(64 << 20)).expect("a slicer");
            let mut bitmap = Bitmap::new(WIDTH, HEIGHT, depth);
            let mut layers = Vec::new();
            while slicer.next_layer(&mut bitmap).expect("a layer").is_some() {
                layers.push(bitmap.data().to_vec());
            }
            layers
        };
        let (first, second, both) = (layers(&[0], 1), layers(&[1], 1), layers(&[0, 1], 3));
        let merged = |a: u8, b: u8| if grey { a.max(b) } else { a | b };
        for ((first, second), both) in first.iter().zip(&second).zip(&both) {
            prop_assert!(first.iter().zip(second).map(|(a, b)| merged(*a, *b)).eq(both.iter().copied()));
        }
        prop_assert_eq!(layers(&[1, 0], 1), both);
    }
}

#[test]
fn a_mirrored_layer_is_the_layer_flipped() {
    let struts = [strut([0, 0, 0], [1500, 900, 200], 60, 30), strut([300, 800, 0], [900, 100, 150], 90, 90)];
    for joint in [CONVOLUTION, Joint::Union] {
        let plain = Part::new(&struts, joint, Depth::Grey, Mirror::default(), 50.0).layers(1, 0);
        let mirrored = Part::new(&struts, joint, Depth::Grey, Mirror { x: true, y: true }, 50.0).layers(1, 0);
        assert!(plain.iter().any(|layer| layer.data().contains(&255)));
        for (plain, mirrored) in plain.iter().zip(&mirrored) {
            for (one, other) in plain.data().iter().zip(mirrored.data().iter().rev()) {
                // Coordinates round differently on the two sides.
                assert!(one.abs_diff(*other) <= 4, "{one} {other}");
            }
        }
    }
}

#[test]
fn the_disc_of_a_long_strut_has_its_radius_and_grey_its_area() {
    for (radius_um, joint) in [(100, CONVOLUTION), (60, CONVOLUTION), (100, Joint::Union), (60, Joint::Union)] {
        let struts = [strut([7, 3, 0], [7, 3, 2000], radius_um, radius_um)];
        let pixel_area = PIXEL_UM[0] * PIXEL_UM[1];
        let area = std::f64::consts::PI * f64::from(radius_um).powi(2);

        let bits = &Part::new(&struts, joint, Depth::Bit, Mirror::default(), 100.0).layers(1, 10)[0];
        let count = bits.data().iter().map(|byte| byte.count_ones()).sum::<u32>();
        let radius_measured = (f64::from(count) * pixel_area / std::f64::consts::PI).sqrt();
        assert!(
            (radius_measured - f64::from(radius_um)).abs() < 0.25 * PIXEL_UM[0],
            "{radius_measured} of {radius_um}"
        );

        let grey = &Part::new(&struts, joint, Depth::Grey, Mirror::default(), 100.0).layers(1, 10)[0];
        let covered = grey.data().iter().map(|grey| f64::from(*grey) / 255.0).sum::<f64>() * pixel_area;
        assert!((covered / area - 1.0).abs() < 0.01, "{joint:?}, radius {radius_um}: {covered} of {area}");

        // Monotone outwards from the middle along a row.
        let middle = (HEIGHT / 2) as usize * WIDTH as usize;
        let right = &grey.data()[middle + WIDTH as usize / 2..middle + WIDTH as usize];
        assert!(right.is_sorted_by(|one, other| one >= other), "{right:?}");
        assert_eq!((right[0], right[right.len() - 1]), (255, 0));
    }
}

/// Discs of 2.5 to 9 pixels' radius, wherever they lie between the pixels, and whether the kernel is wide or narrow.
#[test]
fn grey_shows_the_area_of_small_discs_within_a_percent() {
    for (radius_um, support_um) in [(60, 90.0), (60, 150.0), (85, 268.0), (178, 268.0)] {
        for offset_um in [0, 3, 7, 11] {
            let at = [500 + offset_um, 500 + 2 * offset_um];
            let corners = [strut([0; 3], [0; 3], 20, 20), strut([1900, 1500, 0], [1900, 1500, 0], 20, 20)];
            let long = strut([at[0], at[1], 0], [at[0], at[1], 3000], radius_um, radius_um);
            let part = Part::new(
                &[corners[0], corners[1], long],
                Joint::Convolution { support_um },
                Depth::Grey,
                Mirror::default(),
                100.0,
            );
            let grey = &part.layers(1, 15)[0];
            let covered =
                grey.data().iter().map(|grey| f64::from(*grey) / 255.0).sum::<f64>() * PIXEL_UM[0] * PIXEL_UM[1];
            let area = std::f64::consts::PI * f64::from(radius_um).powi(2);
            assert!(
                (covered / area - 1.0).abs() < 0.01,
                "radius {radius_um}, support {support_um}, offset {offset_um}: {covered} of {area}"
            );
        }
    }
}

#[test]
fn a_part_outside_the_volume_is_refused_with_axis_excess_and_remedy() {
    let refused = |struts: &[Strut]| match SlicePlan::new(
        &header(struts, Joint::Union),
        raster(Mirror::default()),
        Depth::Bit,
        50.0,
    ) {
        Err(PlanError::OutsideVolume(text)) => text,
        other => panic!("{other:?}"),
    };
    // The area is 2.0 × 1.68 mm.
    let text = refused(&[strut([0, 0, 0], [0, 1780, 0], 10, 10)]);
    assert!(text.contains("along y") && text.contains("0.120 mm") && text.contains("--rotate 0,0,90"), "{text}");
    let text = refused(&[strut([0, 0, 0], [0, 0, 100_000], 10, 10)]);
    assert!(text.contains("along z") && text.contains("at most 0.499 times as large"), "{text}");
    assert!(!text.contains("along x") && !text.contains("along y"), "{text}");
    // Every axis that is too long is named: the one that decides is not always the first.
    let text = refused(&[strut([0, 0, 0], [2980, 0, 100_000], 10, 10)]);
    for words in ["3.000 mm along x, 1.000 mm more than the build volume's 2.000 mm", "along z", "at most 0.499 times"]
    {
        assert!(text.contains(words), "`{words}` is not in {text}");
    }
    let text = refused(&[strut([0, 0, 0], [0, 0, 100_000_000], 10, 10)]);
    assert!(text.contains("more than a thousand times too large"), "{text}");
    let mut placed = header(&[strut([0, 0, 0], [500, 0, 0], 10, 10)], Joint::Union);
    placed.placement = Placement::At { x_mm: 0.2, y_mm: 0.5 };
    let error = SlicePlan::new(&placed, raster(Mirror::default()), Depth::Bit, 50.0).expect_err("outside").to_string();
    assert!(error.contains("0.060 mm at the low end of x"), "{error}");
}

/// Its rows are beyond the range of every integer; a header may lie about its bounds.
#[test]
fn a_ball_larger_than_all_pictures_fills_the_layer() {
    let small = [strut([0, 0, 0], [500, 0, 0], 90, 90)];
    let giant = strut([0; 3], [0; 3], (1 << 30) - 1, (1 << 30) - 1);
    let honest = header(&small, Joint::Union);
    let lying =
        Header { materials: None, quantum_um: 1000.0, bounds: Bounds { min: [0; 3], max: [1; 3] }, ..honest.clone() };
    let lattice = Lattice { radius_range: [1, giant.radius_a], ..lattice(&honest) };
    let plan = SlicePlan::new(&lying, raster(Mirror::default()), Depth::Bit, 500.0).expect("it fits");
    let budget = MemoryBudget::new(64 << 20);
    let source = MemoryStruts::new(1000.0, lattice, vec![giant], 1);
    let mut slicer = Slicer::new(vec![BodySource::Lattice(Box::new(source))], plan, 1, 0, &budget).expect("a slicer");
    let mut bitmap = Bitmap::new(WIDTH, HEIGHT, Depth::Bit);
    while slicer.next_layer(&mut bitmap).expect("a layer").is_some() {
        assert!((0..HEIGHT).all(|y| (0..WIDTH).all(|x| lit(&bitmap, x, y))));
    }
}

/// What the lowest layers of 50 µm show, of a part that begins at `bottom_um`.
fn footing(struts: &[Strut], bottom_um: f64, bottom_layers: u32) -> Footing {
    let header = Header { bottom_um, ..header(struts, Joint::Union) };
    let plan = SlicePlan::new(&header, raster(Mirror::default()), Depth::Bit, 50.0).expect("it fits");
    let budget = MemoryBudget::new(64 << 20);
    let bodies = body(lattice(&header), struts, 5);
    Footing::of(&mut Slicer::new(bodies, plan, 1, 0, &budget).expect("a slicer"), bottom_layers).expect("can be sliced")
}

/// The spike is thinner than a pixel and stands between four pixels' centres.
#[test]
fn bottom_layers_that_would_hold_to_nothing_are_found() {
    let ball = |z: i32| strut([0, 0, z], [0, 0, z], 100, 100);
    let spike = |from: i32, to: i32| strut([0, 0, from], [0, 0, to], 1, 1);
    let post = strut([0, 0, 0], [0, 0, 500], 100, 100);
    assert_eq!(footing(&[post], -100.0, 4), Footing::Firm);
    assert_eq!(footing(&[ball(100)], 0.0, 100), Footing::Firm, "fewer layers than bottom layers");
    assert_eq!(footing(&[ball(100), spike(150, 600)], 0.0, 100), Footing::Firm, "dark to the top holds nothing up");
    let on_a_spike = footing(&[spike(0, 400), ball(400)], -1.0, 0);
    assert_eq!(on_a_spike, Footing::Dark { layers: 6 }, "bottom layers or not, the first one matters");
    let told = on_a_spike.problem(10).expect("a problem");
    assert!(told.contains("the lowest 6 layers are dark") && told.contains("--rotate"), "{told}");
    let gap = [ball(100), spike(200, 600), ball(700)];
    assert_eq!(footing(&gap, 0.0, 8), Footing::Gap { first: 4, layers: 8 });
    assert!(footing(&gap, 0.0, 8).problem(16).expect("a problem").contains("layers 4 to 11, counted from 0, are dark"));
    assert_eq!(footing(&gap, 0.0, 3), Footing::Firm, "above the bottom layers it is the part's own affair");
    let hidden = footing(&[post], 300.0, 1);
    assert_eq!(hidden, Footing::Below, "a build file that says too high a bottom");
    assert!(hidden.problem(4).expect("a problem").contains("pack it again"));
    assert_eq!(
        footing(&[spike(0, 400)], -1.0, 2).problem(9).map(|told| told.contains("all layers are dark")),
        Some(true)
    );
}

/// Two lattices in one file share its index and the buffers that read it.
#[test]
fn the_memory_of_a_build_file_is_counted_once_for_all_its_bodies() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let path = directory.path().join("part.layerd");
    let lattice = |joint| BodySettings::Lattice { joint, largest_radius: 90 };
    let settings = WriterSettings {
        materials: None,
        quantum_um: 1.0,
        placement: Placement::Centred,
        source_digest: [0; 32],
        source_name: String::new(),
        bodies: vec![lattice(Joint::Union), lattice(CONVOLUTION)],
    };
    let mut writer = Writer::create(&path, settings).expect("can be created");
    let post = |x: i32| strut([x, 0, 0], [x, 0, 500], 90, 90);
    (0..20_000).for_each(|x| writer.push(post(x / 10)).expect("in order"));
    writer.next_body().expect("one more");
    writer.push(post(700)).expect("in order");
    let header = writer.finish().expect("is whole");
    let file = Arc::new(BuildFile::open(&path).expect("is whole"));
    let plan = SlicePlan::new(&header, wide_raster(), Depth::Bit, 50.0).expect("it fits");
    for threads in [1, 3] {
        let bodies = BodySource::of(&file);
        let [one, other] = [0, 1].map(|body| Slicer::memory_bytes(&bodies[body..=body], &plan, threads));
        let both = Slicer::memory_bytes(&bodies, &plan, threads);
        assert_eq!(one + other - both, (file.memory_bytes() + threads * file.scratch_bytes()) as u64);
        assert!(file.memory_bytes() > 3 * 40, "an index of three chunks");
        let budget = MemoryBudget::new(both);
        let mut slicer = Slicer::new(bodies, plan.clone(), threads, 0, &budget).expect("a slicer");
        assert_eq!(budget.used_bytes(), both, "what was stated is what is charged");
        let mut bitmap = Bitmap::new(plan.raster.width_px, plan.raster.height_px, Depth::Bit);
        assert_eq!(slicer.next_layer(&mut bitmap).expect("a layer"), Some(0));
        assert_eq!(slicer.active_count(), 20_001);
        drop(slicer);
        assert_eq!(budget.used_bytes(), 0);
    }
}

fn wide_raster() -> Raster {
    Raster { width_px: 200, ..raster(Mirror::default()) }
}

#[test]
fn what_cannot_be_sliced_is_an_error() {
    let struts = [strut([0, 0, 0], [500, 0, 0], 90, 90)];
    let part = Part::new(&struts, CONVOLUTION, Depth::Bit, Mirror::default(), 50.0);
    let small = MemoryBudget::new(1000);
    assert!(matches!(Slicer::new(part.bodies(), part.plan.clone(), 1, 0, &small), Err(SliceError::Budget(_))));
    let budget = MemoryBudget::new(64 << 20);
    assert!(matches!(
        Slicer::new(part.bodies(), part.plan.clone(), 0, 0, &budget),
        Err(SliceError::BadThreads { threads: 0, max: Slicer::MAX_THREADS })
    ));
    let mut slicer = Slicer::new(part.bodies(), part.plan.clone(), 1, 0, &budget).expect("a slicer");
    let mut wrong = Bitmap::new(WIDTH, HEIGHT, Depth::Grey);
    assert!(matches!(slicer.next_layer(&mut wrong), Err(SliceError::WrongBitmap)));
    let thick = body(lattice(&header(&struts, Joint::Convolution { support_um: 94.0 })), &struts, 1);
    assert!(matches!(Slicer::new(thick, part.plan.clone(), 1, 0, &budget), Err(SliceError::RadiusTooLarge { .. })));
    for raster in [
        Raster { width_px: 0, ..raster(Mirror::default()) },
        Raster { height_px: Raster::MAX_PX + 1, ..raster(Mirror::default()) },
        Raster { pixel_um: [20.0, f64::NAN], ..raster(Mirror::default()) },
    ] {
        let planned = SlicePlan::new(&part.header, raster, Depth::Bit, 50.0);
        assert!(matches!(planned, Err(PlanError::BadRaster(_))), "{raster:?}");
    }
    // A header that lies about its radii.
    let plan = SlicePlan::new(&part.header, raster(Mirror::default()), Depth::Bit, 50.0).expect("it fits");
    let lying = Lattice { radius_range: [10, 80], ..lattice(&part.header) };
    let mut slicer = Slicer::new(body(lying, &struts, 1), plan, 1, 0, &budget).expect("a slicer");
    let error = slicer.next_layer(&mut Bitmap::new(WIDTH, HEIGHT, Depth::Bit)).expect_err("lying").to_string();
    assert!(error.contains("radius"), "{error}");
}
