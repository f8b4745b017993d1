//! Areas of discs and rings against formulas, nesting, the edge of the picture, many bands, several bodies, and the budget.

use std::f64::consts::PI;

use layerd::buildfile::{Cap, Caps, Joint, Strut};
use layerd::layer::{Depth, Mirror, Raster};
use layerd::slice::scan::{Contours, Region};
use layerd::slice::{BodySource, SliceError, SlicePlan};
use layerd::stream::MemoryBudget;

use crate::rings::{crossing, signed_area};
use crate::slice_part::{Part, body, header, lattice, raster, strut};
use crate::{Way, layers};

/// The only region of a layer in the middle of a part.
fn middle(struts: &[Strut], joint: Joint, pixel_um: f64, tolerance_um: f64) -> Vec<Region> {
    let raster = Raster { pixel_um: [pixel_um; 2], width_px: 400, height_px: 400, ..raster(Mirror::default()) };
    let part = Part::on(raster, struts, joint, Depth::Bit, 50.0);
    let all = layers(|| part.bodies(), &part.plan, Way::with_tolerance(tolerance_um));
    all[all.len() / 2].clone()
}

fn only(regions: &[Region]) -> &Region {
    assert_eq!(regions.len(), 1, "{regions:?}");
    &regions[0]
}

/// Simplification keeps the area, however few points are left.
#[test]
fn a_disc_has_the_area_of_its_radius() {
    for radius_um in [80, 150, 400, 1500] {
        for joint in [Joint::Union, Joint::Convolution { support_um: 1.5 * f64::from(radius_um) }] {
            let post = [strut([11, 5, 0], [11, 5, 6 * radius_um], radius_um as u32, radius_um as u32)];
            let area_um2 = PI * f64::from(radius_um).powi(2);
            let mut counts = Vec::new();
            for tolerance_um in [0.0, 2.0, 5.0] {
                let regions = middle(&post, joint, 30.0, tolerance_um);
                let disc = only(&regions);
                let share = disc.area_um2() / area_um2 - 1.0;
                // A chord of a pixel's length lies 30²/12r µm inside the arc in the mean, and linear interpolation of a curved field is
                // about as far off.
                let bound = 0.002 + 3.0 * 900.0 / 12.0 / f64::from(radius_um).powi(2);
                assert!(share.abs() < bound, "{radius_um} µm {joint:?} {tolerance_um} µm: {share}");
                counts.push(disc.outer.len());
            }
            assert!(counts[2] * 2 < counts[0] && counts[2] <= counts[1], "{counts:?}");
        }
    }
}

/// A torus of many short struts, cut in its plane and across.
#[test]
fn a_torus_is_a_ring_with_a_hole_or_two_discs() {
    let (major_um, minor_um) = (1500.0, 200.0);
    let at = |number: u32, upright: bool| {
        let (sin, cos) = (2.0 * PI * f64::from(number) / 180.0).sin_cos();
        let [x, y] = [cos, sin].map(|share| (major_um * share).round() as i32);
        if upright { [x, 7, y] } else { [x, y, 7] }
    };
    for upright in [false, true] {
        let struts: Vec<_> =
            (0..180).map(|number| strut(at(number, upright), at(number + 1, upright), 200, 200)).collect();
        for tolerance_um in [0.0, 5.0] {
            let regions = middle(&struts, Joint::Union, 20.0, tolerance_um);
            if upright {
                // The layer's middle may lie half a layer from the torus's: the discs are wider by a thousandth.
                assert_eq!(regions.iter().map(|region| region.holes.len()).collect::<Vec<_>>(), [0, 0]);
                for region in &regions {
                    assert!(
                        (region.area_um2() / (PI * minor_um * minor_um) - 1.0).abs() < 0.01,
                        "{}",
                        region.area_um2()
                    );
                }
            } else {
                let ring = only(&regions);
                let [hole] = &ring.holes[..] else { panic!("{} holes", ring.holes.len()) };
                let width = |z_um: f64| (minor_um * minor_um - z_um * z_um).sqrt();
                let areas =
                    [0.0, 50.0].map(|z_um| PI * ((major_um + width(z_um)).powi(2) - (major_um - width(z_um)).powi(2)));
                assert!(
                    ring.area_um2() < areas[0] * 1.004 && ring.area_um2() > areas[1] * 0.996,
                    "{}",
                    ring.area_um2()
                );
                let inner = PI * (major_um - minor_um).powi(2);
                assert!((-signed_area(hole) / inner - 1.0).abs() < 0.02);
            }
        }
    }
}

/// Squares of struts within squares: region, hole, region in the hole, hole.
#[test]
fn islands_in_holes_are_regions_of_their_own() {
    let square = |half: i32| {
        let corner = [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]];
        (0..4).map(|at| strut(corner[at], corner[(at + 1) % 4], 60, 60)).collect::<Vec<_>>()
    };
    let struts: Vec<_> = [900, 600, 300].into_iter().flat_map(square).chain([strut([0; 3], [0; 3], 60, 60)]).collect();
    for mirror in
        [Mirror::default(), Mirror { x: true, y: false }, Mirror { x: false, y: true }, Mirror { x: true, y: true }]
    {
        let raster = Raster { pixel_um: [20.0; 2], height_px: 100, ..raster(mirror) };
        let part = Part::on(raster, &struts, Joint::Union, Depth::Bit, 120.0);
        let all = layers(|| part.bodies(), &part.plan, Way::with_tolerance(5.0));
        let [regions] = &all[..] else { panic!("{} layers", all.len()) };
        let mut holes: Vec<_> = regions.iter().map(|region| (region.outer.len() > 2, region.holes.len())).collect();
        holes.sort_unstable();
        assert_eq!(holes, [(true, 0), (true, 1), (true, 1), (true, 1)], "{mirror:?}");
        for region in regions {
            assert!(signed_area(&region.outer) > 0.0);
            for hole in &region.holes {
                let share = -signed_area(hole) / signed_area(&region.outer);
                assert!(share > 0.4 && share < 1.0, "the hole of another region: {share}");
            }
        }
    }
}

/// What leaves the picture is cut off at its edge, half a pixel beyond the outermost centres.
#[test]
fn the_edge_of_the_picture_closes_rings() {
    let struts = [strut([0, 0, 0], [1000, 0, 0], 100, 100)];
    let giant = [strut([0; 3], [0; 3], 1 << 20, 1 << 20)];
    let part = Part::new(&struts, Joint::Union, Depth::Bit, Mirror::default(), 50.0);
    let large = lattice(&header(&giant, Joint::Union));
    for tolerance_um in [0.0, 5.0] {
        let all = layers(|| body(large.clone(), &giant, 5), &part.plan, Way::with_tolerance(tolerance_um));
        for regions in &all {
            let picture = only(regions);
            let [width_um, height_um] = part.plan.raster.area_um();
            // Corners are cut off.
            assert!((picture.area_um2() / (width_um * height_um) - 1.0).abs() < 1e-3, "{}", picture.area_um2());
            let inside =
                |point: &[f64; 2]| (0.0..=width_um).contains(&point[0]) && (0.0..=height_um).contains(&point[1]);
            assert!(picture.outer.iter().all(inside));
            assert_eq!(crossing(regions), None);
        }
    }
}

/// A picture so wide that a band has eight rows: a hundred struts cross all of them.
#[test]
fn many_bands_give_the_regions_of_one() {
    let struts: Vec<_> = (0..100)
        .map(|number| strut([number * 2500, 0, 0], [number * 2500 + 900 - number * 18, 2000, 40], 100, 130))
        .collect();
    let of = |width_px: u32, union: bool| {
        let joint = if union { Joint::Union } else { Joint::Convolution { support_um: 200.0 } };
        let raster = Raster { width_px, height_px: 120, pixel_um: [20.0; 2], ..raster(Mirror::default()) };
        let part = Part::on(raster, &struts, joint, Depth::Bit, 120.0);
        (layers(|| part.bodies(), &part.plan, Way { threads: 2, ..Way::with_tolerance(5.0) }), part)
    };
    for union in [false, true] {
        let (wide, part) = of(25_000, union);
        let single = layers(|| part.bodies(), &part.plan, Way::with_tolerance(5.0));
        assert_eq!(wide, single);
        for regions in &wide {
            assert_eq!(crossing(regions), None);
            assert!(regions.iter().all(|region| region.holes.is_empty()));
        }
        assert_eq!(wide[1].len(), 100, "one region for each strut");
    }
}

/// Regions of two bodies of different joints are those of their union.
#[test]
fn bodies_are_united() {
    let post = [strut([0, 0, 0], [0, 0, 2000], 300, 300)];
    let bar = [strut([-500, 0, 1000], [900, 0, 1000], 150, 150)];
    let all = [&post[..], &bar].concat();
    let raster = Raster { pixel_um: [20.0; 2], ..raster(Mirror::default()) };
    let plan = SlicePlan::new(&header(&all, Joint::Union), raster, Depth::Bit, 100.0).expect("it fits");
    let convolution = Joint::Convolution { support_um: 450.0 };
    let bodies = || -> Vec<BodySource> {
        let one = body(lattice(&header(&post, convolution)), &post, 5);
        let other = body(lattice(&header(&bar, Joint::Union)), &bar, 5);
        one.into_iter().chain(other).collect()
    };
    let layers = layers(bodies, &plan, Way::with_tolerance(5.0));
    // The plane nearest to the bar's axis: a disc of 300 µm with a bar of about 150 µm on both sides.
    let nearest = layers.iter().max_by(|one, other| area(one).total_cmp(&area(other))).expect("layers");
    let region = only(nearest);
    let cap = |x: f64| 300.0_f64.powi(2) * (x / 300.0).asin() + x * (300.0_f64.powi(2) - x * x).sqrt();
    let bar_area = 2.0 * 150.0 * 1400.0 + PI * 150.0 * 150.0;
    let united = PI * 300.0 * 300.0 + bar_area - 2.0 * cap(150.0);
    assert!((region.area_um2() / united - 1.0).abs() < 0.05, "{} of {united}", region.area_um2());
}

fn area(regions: &[Region]) -> f64 {
    regions.iter().map(Region::area_um2).sum()
}

/// Flat ends are straight, and their corners are within a pixel.
#[test]
fn a_flat_end_is_where_it_is() {
    let caps = Caps { a: Cap::Butt, b: Cap::Butt };
    let flat = [Strut { caps, ..strut([0, 0, 0], [1500, 0, 0], 300, 300) }];
    let regions = middle(&flat, Joint::Union, 20.0, 5.0);
    let region = only(&regions);
    let width_um = 2.0 * (300.0_f64.powi(2) - 25.0_f64.powi(2)).sqrt();
    assert!((region.area_um2() / (1500.0 * width_um) - 1.0).abs() < 0.005, "{}", region.area_um2());
}

#[test]
fn a_layer_that_is_too_complex_for_the_budget_is_an_error_that_says_so() {
    let struts: Vec<_> = (0..3000)
        .map(|number| {
            strut([number % 60 * 120, number / 60 * 120, 0], [number % 60 * 120, number / 60 * 120, 900], 40, 40)
        })
        .collect();
    let raster = Raster { width_px: 900, height_px: 800, pixel_um: [10.0; 2], ..raster(Mirror::default()) };
    let part = Part::on(raster, &struts, Joint::Union, Depth::Bit, 50.0);
    let fixed_bytes = Contours::memory_bytes(&part.bodies(), &part.plan, 1);
    let contours = |more: u64| {
        let budget = MemoryBudget::new(fixed_bytes + more);
        (Contours::new(part.bodies(), part.plan.clone(), 5.0, 1, 5, &budget).expect("the fixed part fits"), budget)
    };
    for more in [0, 100 << 10, 1 << 20, 3 << 20] {
        let (mut small, budget) = contours(more);
        let error = small.next_layer().expect_err("too complex");
        assert!(matches!(error, SliceError::TooComplex { layer: 5, .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains("layer 5 is too complex") && text.contains("memory budget of"), "{text}");
        assert!(budget.peak_bytes() <= budget.limit_bytes());
    }
    let (mut enough, budget) = contours(64 << 20);
    let layer = enough.next_layer().expect("fits").expect("a layer");
    assert_eq!(layer.regions().len(), 3000);
    let points: usize = layer.regions().iter().map(|region| region.outer.len()).sum();
    let with_layer = budget.used_bytes();
    drop(layer);
    assert!(with_layer - budget.used_bytes() >= 16 * points as u64, "regions are charged while they are kept");
    drop(enough);
    assert_eq!(budget.used_bytes(), 0);
}

#[test]
fn what_cannot_be_cut_is_an_error() {
    let struts = [strut([0, 0, 0], [500, 0, 0], 90, 90)];
    let part = Part::new(&struts, Joint::Union, Depth::Bit, Mirror::default(), 50.0);
    let budget = MemoryBudget::new(64 << 20);
    for tolerance_um in [-1.0, f64::NAN, f64::INFINITY] {
        let made = Contours::new(part.bodies(), part.plan.clone(), tolerance_um, 1, 0, &budget);
        assert!(matches!(made, Err(SliceError::BadTolerance(_))));
    }
    let made = Contours::new(part.bodies(), part.plan.clone(), 5.0, 1, 0, &MemoryBudget::new(1000));
    assert!(matches!(made, Err(SliceError::Budget(_))));
    let made = Contours::new(part.bodies(), part.plan.clone(), 5.0, 0, 0, &budget);
    assert!(matches!(made, Err(SliceError::BadThreads { threads: 0, .. })));
}
